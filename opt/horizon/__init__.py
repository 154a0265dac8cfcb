"""The whole-horizon planner: see docs/horizon.md."""

from ffsms_pin.opt.horizon.motion import keeps_clear
from ffsms_pin.opt.horizon.search import plan_horizon

__all__ = ["keeps_clear", "plan_horizon"]
