"""Limits: what must hold."""

from typing import TYPE_CHECKING

from ffsms_pin.extras import later

if TYPE_CHECKING:  # and each when it is first used: parts are made of what `limits.limit` has
    from ffsms_pin.opt.limits.clearance import Clearance, Obstacle
    from ffsms_pin.opt.limits.limit import UNBOUNDED, Limit, Rows, Violation
    from ffsms_pin.opt.limits.motion import AlphaBox, BaseLimits, JointLimits
    from ffsms_pin.opt.limits.motors import TorqueLimits, WheelLimits

__all__ = [
    "UNBOUNDED",
    "AlphaBox",
    "BaseLimits",
    "Clearance",
    "JointLimits",
    "Limit",
    "Obstacle",
    "Rows",
    "TorqueLimits",
    "Violation",
    "WheelLimits",
]

if not TYPE_CHECKING:
    __getattr__, __dir__ = later(__name__)
