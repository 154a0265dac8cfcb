"""Little wheel momentum as a term."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ffsms_pin.checks import at_least_zero
from ffsms_pin.opt.motion import Features
from ffsms_pin.opt.terms.term import Term, time_scale

__all__ = ["WheelMomentum"]


@dataclass(frozen=True)
class WheelMomentum(Term):
    """Little momentum of the wheels that hold the attitude; nothing where no wheels do.

    Attributes
    ----------
    weight : float
        On the integral of the wheels' squared momenta [1/(N m s)^2 1/s, for a motion of 8 s].
    """

    weight: float = 1.0
    name = "wheel momentum"

    def __post_init__(self) -> None:
        at_least_zero("weight", self.weight)

    def residual(self, m: Features) -> Any:
        """The momentum of each wheel."""
        return np.sqrt(self.weight) * time_scale(m) * m.wheels
