"""Little joint travel as a term."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ffsms_pin.checks import at_least_zero
from ffsms_pin.opt.motion import Features
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
    idle : float
        How many times as much the square counts of a joint that does not move the end effector, such as those
        of a second arm. The paper's cost may fall by some 1e-4 s where an idle arm swings; with the default
        that is seldom worth it, while terms and limits of the base still are.
    """

    weight: float = _LIGHT
    idle: float = 100.0
    name = "effort"
    smooths = True

    def __post_init__(self) -> None:
        at_least_zero("weight", self.weight)
        at_least_zero("idle", self.idle)

    @property
    def tie_breaker(self) -> bool:
        """Whether the weight is no greater than the default; a greater one is paid for with cost."""
        return self.weight <= _LIGHT

    def residual(self, m: Features) -> Any:
        """The joint rates."""
        idle = np.where(m.stack.moves_tip == 0.0, np.sqrt(self.idle), 1.0)
        return np.sqrt(self.weight) * time_scale(m) * idle * m.rates
