"""Friction in the joints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, per_joint, positive
from ffsms_pin.errors import InvalidValue

__all__ = ["JointFriction"]


@dataclass(frozen=True)
class JointFriction:
    """Viscous and Coulomb friction: a torque -(viscous qd + coulomb tanh(qd / transition)) in each joint.

    Near standstill Coulomb's step is a steep slope, so that it can be integrated: a joint creeps under a
    torque below `coulomb` instead of sticking. Backlash and flexible joints are not modelled.

    Parameters
    ----------
    viscous : array_like
        [N m s/rad]: one number or (n,).
    coulomb : array_like
        [N m]: one number or (n,).
    transition : float
        Rate at which three quarters of the Coulomb torque are there [rad/s]. Too small a one makes the plant
        stiff: keep coulomb / (transition H_q) below one over the step, or use the "stiff" integrator.
    """

    viscous: ArrayLike = 0.0
    coulomb: ArrayLike = 0.0
    transition: float = 1e-2

    def torque(self, n: int) -> Callable[[FloatArray], FloatArray]:
        """The torques (n,) as a function of the joint rates (n,)."""
        viscous, coulomb = (
            _at_least_zero("viscous", self.viscous, n),
            _at_least_zero("coulomb", self.coulomb, n),
        )
        slope = 1.0 / positive("transition", self.transition, "rad/s")
        return lambda rates: -(viscous * rates + coulomb * np.tanh(slope * rates))


def _at_least_zero(name: str, value: ArrayLike, n: int) -> FloatArray:
    numbers = per_joint(name, value, n)
    if not (numbers >= 0.0).all():
        raise InvalidValue(name, value, "must be at least zero")
    return numbers
