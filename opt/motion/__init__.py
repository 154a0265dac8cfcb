"""Motions of the arm at stacks of configurations, and features of them: what parts are formulas of."""

from ffsms_pin.opt.motion.feature import Feature
from ffsms_pin.opt.motion.features import Features
from ffsms_pin.opt.motion.motions import Motions

__all__ = ["Feature", "Features", "Motions"]
