"""Control: joint torques that make a free-floating arm follow a joint motion, and laws of the base."""

from ffsms_pin.control.attitude_laws import Coordinated, MomentumDump, QuaternionFeedback
from ffsms_pin.control.base_command import BaseCommand, BaseLaw, BaseView, PulseWidth, StationKeeping
from ffsms_pin.control.impedance import Admittance, Impedance
from ffsms_pin.control.law import JointLaw, reduced_dynamics
from ffsms_pin.control.laws import LAWS, PD, ComputedTorque, SlidingModeController
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
