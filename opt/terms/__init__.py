"""Terms: what a motion should be like."""

from ffsms_pin.opt.terms.term import Term
from ffsms_pin.opt.terms.terms import (
    BaseTurn,
    Coupling,
    Effort,
    Propellant,
    Smooth,
    WheelEnergy,
    WheelMomentum,
)

__all__ = ["BaseTurn", "Coupling", "Effort", "Propellant", "Smooth", "Term", "WheelEnergy", "WheelMomentum"]
