"""Little turning of the base as a term."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ffsms_pin.checks import at_least_zero
from ffsms_pin.opt.motion import Features
from ffsms_pin.opt.terms.term import Term, time_scale

__all__ = ["BaseTurn"]

_UNIT = 32.0  # [s^2/rad^2] of the weight: 0.01 s of cost for 0.05 rad in 8 s


@dataclass(frozen=True)
class BaseTurn(Term):
    """Little turning of the base.

    Attributes
    ----------
    weight : float
        On the integral of the squared angular velocity of the base [32 s^2/rad^2, for a motion of 8 s]. With
        1 a base that turns evenly by 0.05 rad costs as much as 0.01 s of the paper's cost integral: enough to
        choose between motions that are nearly free.
    """

    weight: float = 1.0
    name = "base turn"

    def __post_init__(self) -> None:
        at_least_zero("weight", self.weight)

    def residual(self, m: Features) -> Any:
        """The angular velocity."""
        return np.sqrt(_UNIT * self.weight) * time_scale(m) * m.base_spin
