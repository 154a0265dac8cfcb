"""Motions as parts see them: features, which carry their slopes, and frames of the robot."""

from ffsms_pin.opt.motion.feature import Feature
from ffsms_pin.opt.motion.features import Features

__all__ = ["Feature", "Features"]
