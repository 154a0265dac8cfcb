"""Control laws of the joints and of the base."""

from ffsms_pin.control.attitude_laws import Coordinated, MomentumDump, QuaternionFeedback
from ffsms_pin.control.base_command import BaseCommand, BaseLaw, BaseView, PulseWidth, StationKeeping
from ffsms_pin.control.impedance import Admittance, Impedance
from ffsms_pin.control.laws import PD, ComputedTorque, JointLaw, SlidingModeController, reduced_dynamics
from ffsms_pin.control.stopping import StoppingLaw

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
    "PulseWidth",
    "QuaternionFeedback",
    "SlidingModeController",
    "StationKeeping",
    "StoppingLaw",
    "reduced_dynamics",
]

# The keys are the names that scenario files use.
LAWS: dict[str, type[JointLaw]] = {
    "sliding-mode": SlidingModeController,
    "computed-torque": ComputedTorque,
    "pd": PD,
    "impedance": Impedance,
    "admittance": Admittance,
}
