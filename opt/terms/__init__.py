"""Terms: what a motion should be like."""

from ffsms_pin.opt.terms.base import BaseTurn, Propellant, WheelEnergy, WheelMomentum
from ffsms_pin.opt.terms.paper import Coupling, Effort, Smooth
from ffsms_pin.opt.terms.term import Term

__all__ = ["BaseTurn", "Coupling", "Effort", "Propellant", "Smooth", "Term", "WheelEnergy", "WheelMomentum"]
