"""Little joint travel as a term."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffsms_pin.checks import at_least_zero
from ffsms_pin.opt.batch.motions import Motions
from ffsms_pin.opt.batch.residual import JointResidual, Residuals
from ffsms_pin.opt.terms.term import Term, time_scale

__all__ = ["Effort"]

_LIGHT = 1e-4  # the default weight: it decides only between motions of equal cost


@dataclass(frozen=True)
class Effort(Term):
    """Little joint travel.

    Attributes
    ----------
    weight : float
        On the integral of the squared joint rates [s^2/rad^2, for a motion of 8 s]. The default makes a
        motion that turns joints by 3 rad more cost as much as 1e-3 s of the paper's cost integral.
    """

    weight: float = _LIGHT
    name = "effort"
    smooths = True

    def __post_init__(self) -> None:
        at_least_zero("weight", self.weight)

    @property
    def tie_breaker(self) -> bool:
        """Whether the weight is no greater than the default; a greater one is paid for with cost."""
        return self.weight <= _LIGHT

    def residual(self, motions: Motions) -> Residuals:
        """The joint rates."""
        root = np.sqrt(self.weight) * time_scale(motions)
        return [JointResidual(root * motions.rates, by_rate=np.full((1, 1, 1), root))]
