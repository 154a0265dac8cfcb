"""Atlases: the coupling of a robot over its joint ranges and its workspace, and over designs of it."""

from ffsms_pin.atlas.build import atlas, open_atlas
from ffsms_pin.atlas.designs import Design
from ffsms_pin.atlas.measures import Sampling, measured
from ffsms_pin.atlas.sweep import Sweep, sweep

__all__ = ["Design", "Sampling", "Sweep", "atlas", "measured", "open_atlas", "sweep"]
