"""Limits: what must hold."""

from ffsms_pin.opt.limits.base import BaseLimits
from ffsms_pin.opt.limits.clearance import Clearance, Obstacle
from ffsms_pin.opt.limits.corridor import Corridor
from ffsms_pin.opt.limits.joints import AlphaBox, JointLimits
from ffsms_pin.opt.limits.limit import UNBOUNDED, Limit, Rows, Violation
from ffsms_pin.opt.limits.motors import TorqueLimits, WheelLimits

__all__ = [
    "UNBOUNDED",
    "AlphaBox",
    "BaseLimits",
    "Clearance",
    "Corridor",
    "JointLimits",
    "Limit",
    "Obstacle",
    "Rows",
    "TorqueLimits",
    "Violation",
    "WheelLimits",
]
