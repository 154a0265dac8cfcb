"""Terms: what a motion should be like. One class a file."""

from ffsms_pin.opt.terms.base_turn import BaseTurn
from ffsms_pin.opt.terms.coupling import Coupling
from ffsms_pin.opt.terms.effort import Effort
from ffsms_pin.opt.terms.propellant import Propellant
from ffsms_pin.opt.terms.smooth import Smooth
from ffsms_pin.opt.terms.term import Term
from ffsms_pin.opt.terms.wheel_energy import WheelEnergy
from ffsms_pin.opt.terms.wheel_momentum import WheelMomentum

__all__ = ["BaseTurn", "Coupling", "Effort", "Propellant", "Smooth", "Term", "WheelEnergy", "WheelMomentum"]
