"""Little wheel momentum as a term."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffsms_pin.checks import at_least_zero
from ffsms_pin.opt.batch.motions import Motions
from ffsms_pin.opt.batch.residual import Residual, Residuals
from ffsms_pin.opt.batch.wheels import momentum_slopes_by_joints, wheel_momentum, wheel_shares
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

    def residual(self, motions: Motions) -> Residuals:
        """The momentum of each wheel."""
        wheels = motions.wheels
        if wheels is None:
            return []
        root = np.sqrt(self.weight) * time_scale(motions)
        momentum, shares = wheel_momentum(motions), wheel_shares(wheels)
        by_joints, by_rates = momentum_slopes_by_joints(motions)
        return [
            Residual(
                root * momentum[i],
                by_joints=-root * np.einsum("x,xjsk->jsk", shares[i], by_joints),
                by_rates=-root * np.einsum("x,xjsk->jsk", shares[i], by_rates),
            )
            for i in range(len(wheels))
        ]
