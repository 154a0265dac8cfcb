"""Control: joint torques that make a free-floating arm follow a joint motion, and laws of the base."""

from typing import TYPE_CHECKING

from ffsms_pin.control.reduced_dynamics import reduced_coriolis, reduced_dynamics  # named as its module
from ffsms_pin.extras import later

if TYPE_CHECKING:  # and each when it is first used
    from ffsms_pin.control.attitude_laws import Coordinated, MomentumDump, QuaternionFeedback
    from ffsms_pin.control.base_command import BaseCommand, BaseLaw, BaseView, PulseWidth
    from ffsms_pin.control.impedance import Admittance, Impedance
    from ffsms_pin.control.law import JointLaw, check_time_constants
    from ffsms_pin.control.laws import LAWS, PD, ComputedTorque
    from ffsms_pin.control.sliding_mode import PassivitySlidingMode, SlidingModeController
    from ffsms_pin.control.station_keeping import StationKeeping
    from ffsms_pin.control.super_twisting import SuperTwisting

__all__ = [
    "LAWS",
    "PD",
    "Admittance",
    "BaseCommand",
    "BaseLaw",
    "BaseView",
    "ComputedTorque",
    "Coordinated",
    "Impedance",
    "JointLaw",
    "MomentumDump",
    "PassivitySlidingMode",
    "PulseWidth",
    "QuaternionFeedback",
    "SlidingModeController",
    "StationKeeping",
    "SuperTwisting",
    "check_time_constants",
    "reduced_coriolis",
    "reduced_dynamics",
]

if not TYPE_CHECKING:
    __getattr__, __dir__ = later(__name__)
