"""Limits: what must hold."""

from typing import TYPE_CHECKING

from ffsms_pin.extras import later

if TYPE_CHECKING:  # and each when it is first used: parts are made of what `limits.limit` has
    from ffsms_pin.opt.limits.clearance import Clearance as Clearance, Obstacle as Obstacle
    from ffsms_pin.opt.limits.limit import (
        UNBOUNDED as UNBOUNDED,
        Limit as Limit,
        Rows as Rows,
        Violation as Violation,
    )
    from ffsms_pin.opt.limits.motion import (
        AlphaBox as AlphaBox,
        BaseLimits as BaseLimits,
        JointLimits as JointLimits,
    )
    from ffsms_pin.opt.limits.motors import TorqueLimits as TorqueLimits, WheelLimits as WheelLimits
else:
    __getattr__, __dir__, __all__ = later(__name__)
