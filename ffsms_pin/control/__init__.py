"""Control: joint torques that make a free-floating arm follow a joint motion, and laws of the base."""

from typing import TYPE_CHECKING

from ffsms_pin.extras import later

if TYPE_CHECKING:  # and each when it is first used
    from ffsms_pin.control.attitude_laws import (
        Coordinated as Coordinated,
        MomentumDump as MomentumDump,
        QuaternionFeedback as QuaternionFeedback,
    )
    from ffsms_pin.control.base_command import (
        BaseCommand as BaseCommand,
        BaseLaw as BaseLaw,
        BaseView as BaseView,
        PulseWidth as PulseWidth,
        StationKeeping as StationKeeping,
    )
    from ffsms_pin.control.impedance import Admittance as Admittance, Impedance as Impedance
    from ffsms_pin.control.law import JointLaw as JointLaw, reduced_dynamics as reduced_dynamics
    from ffsms_pin.control.laws import LAWS as LAWS, PD as PD, ComputedTorque as ComputedTorque
    from ffsms_pin.control.sliding_mode import SlidingModeController as SlidingModeController
else:
    __getattr__, __dir__, __all__ = later(__name__)
