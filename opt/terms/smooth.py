"""Small joint accelerations as a term."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ffsms_pin.checks import at_least_zero
from ffsms_pin.opt.motion import Features
from ffsms_pin.opt.terms.term import Term, time_scale

__all__ = ["Smooth"]

_LIGHT = 1e-5  # the default weight: it decides only between motions of equal cost


@dataclass(frozen=True)
class Smooth(Term):
    """Small joint accelerations.

    Attributes
    ----------
    weight : float
        On the integral of the squared accelerations [s^4/rad^2, for a motion of 8 s]. The default is small:
        it decides between motions of equal cost.
    """

    weight: float = _LIGHT
    name = "smooth"
    smooths = True

    def __post_init__(self) -> None:
        at_least_zero("weight", self.weight)

    @property
    def tie_breaker(self) -> bool:
        """Whether the weight is no greater than the default; a greater one is paid for with cost."""
        return self.weight <= _LIGHT

    def residual(self, m: Features) -> Any:
        """The joint accelerations."""
        return np.sqrt(self.weight) * time_scale(m) ** 2 * m.accelerations
