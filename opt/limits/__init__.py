"""Limits: what must hold. One class a file, and its rows for a step beside it."""

from ffsms_pin.opt.limits.alpha_box import AlphaBox
from ffsms_pin.opt.limits.base import BaseLimits
from ffsms_pin.opt.limits.clearance import Clearance, Obstacle
from ffsms_pin.opt.limits.corridor import Corridor
from ffsms_pin.opt.limits.joints import JointLimits
from ffsms_pin.opt.limits.limit import UNBOUNDED, Limit, Rows, Violation
from ffsms_pin.opt.limits.torques import TorqueLimits
from ffsms_pin.opt.limits.wheels import WheelLimits

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
