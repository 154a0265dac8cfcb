"""Control: joint torques that make a free-floating arm follow a joint motion, the base reacting."""

from ffsms_pin.control.reduced_dynamics import reduced_dynamics
from ffsms_pin.control.sliding_mode import SlidingModeController

__all__ = ["SlidingModeController", "reduced_dynamics"]
