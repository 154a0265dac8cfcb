"""The joints' control laws by name."""

from ffsms_pin.control.law import JointLaw
from ffsms_pin.control.passivity import PassivitySlidingMode
from ffsms_pin.control.pd import PD, ComputedTorque
from ffsms_pin.control.sliding_mode import SlidingModeController
from ffsms_pin.control.super_twisting import SuperTwisting

__all__ = ["LAWS"]

# By the names that scenario files use.
LAWS: dict[str, type[JointLaw]] = {
    "sliding-mode": SlidingModeController,
    "passivity": PassivitySlidingMode,
    "super-twisting": SuperTwisting,
    "computed-torque": ComputedTorque,
    "pd": PD,
}
