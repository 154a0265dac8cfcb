"""Atlases: the coupling of a robot over its joint ranges and its workspace, and over designs of it."""

from typing import TYPE_CHECKING

from ffsms_pin.atlas.sweep import Sweep as Sweep, sweep as sweep
from ffsms_pin.extras import later

if TYPE_CHECKING:  # and each when it is first used
    from ffsms_pin.atlas.build import atlas as atlas, open_atlas as open_atlas
    from ffsms_pin.atlas.designs import Design as Design
    from ffsms_pin.atlas.measures import Sampling as Sampling, measured as measured
else:
    __getattr__, __dir__, __all__ = later(__name__)
