"""Residuals of whole motions, and their slopes by what moves: the language of terms, goals and limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray

__all__ = ["Indices", "JointResidual", "Residual", "Residuals"]

Indices: TypeAlias = NDArray[np.signedinteger[Any]]


@dataclass(frozen=True, eq=False)
class Residual:
    """A number at instants of motions, and its slopes, in inertial axes; what is left out does not matter.

    Dense, with values at K instants of each of S motions; or, where most are zero, only V entries of them:
    then `motion` says of which motions they are, `instants` at which instants, and (S, K) below reads (V,).

    Attributes
    ----------
    value : ndarray, shape (S, K)
    instants : ndarray of int, shape (K,), or slice
        Indices of the instants, as in `Motions.times`. Default: all.
    motion : ndarray of int, shape (V,), or None
    over_time : bool
        Whether the square is integrated over time; otherwise it counts as it is.
    by_joints, by_rates : ndarray, shape (n, S, K)
        By the joint positions and rates, whatever moves with them held still.
    by_accelerations : ndarray, shape (n, S, K)
        By the joint accelerations.
    by_tip, by_turn : ndarray, shape (3, S, K)
        By the end effector's position, and by a turn of it (rotation vector).
    by_velocity, by_spin : ndarray, shape (3, S, K)
        By its velocity and angular velocity.
    by_base, by_base_turn, by_base_spin : ndarray, shape (3, S, K)
        By the position of the base's centre of mass, a turn of the base, and its angular velocity.
    by_entropy : ndarray, shape (S, K)
        By H_norm.
    by_coupling : ndarray, shape (6, n, S, K)
        By the entries of C_bm in base axes (`ArmValues.coupling`).
    later : callable, optional
        Makes the slopes by these names once they are wanted, instead.
    """

    value: FloatArray
    instants: Indices | slice = field(default_factory=lambda: slice(None))
    motion: Indices | None = None
    over_time: bool = True
    by_joints: FloatArray | None = None
    by_rates: FloatArray | None = None
    by_accelerations: FloatArray | None = None
    by_tip: FloatArray | None = None
    by_turn: FloatArray | None = None
    by_velocity: FloatArray | None = None
    by_spin: FloatArray | None = None
    by_base: FloatArray | None = None
    by_base_turn: FloatArray | None = None
    by_base_spin: FloatArray | None = None
    by_entropy: FloatArray | None = None
    by_coupling: FloatArray | None = None
    later: Callable[[], dict[str, FloatArray]] | None = None

    def slopes(self) -> dict[str, FloatArray]:
        """The slopes that there are, by name."""
        if self.later is not None:
            return self.later()
        named = {name: getattr(self, name) for name in _SLOPES}
        return {name: x for name, x in named.items() if x is not None}

    def squares(self, weights: FloatArray, motions: int = 1) -> FloatArray:
        """Sum of squares (S,), integrated with the weights (of all instants) where it is over time."""
        square = self.value * self.value
        if self.over_time:
            square = square * weights[self.instants]
        if self.motion is None:
            return np.asarray(square.sum(axis=1))
        sums: FloatArray = np.bincount(self.motion, square, minlength=motions).astype(np.float64)
        return sums


_SLOPES = [one.name for one in fields(Residual) if one.name.startswith("by_")]


@dataclass(frozen=True, eq=False)
class JointResidual:
    """A number a joint at every instant that depends on that joint alone; integrated over time.

    Attributes
    ----------
    value : ndarray, shape (n, S, K)
    by_position, by_rate, by_acceleration : ndarray, shape (n, S, K) or broadcastable
        By the joint's own position, rate and acceleration.
    """

    value: FloatArray
    by_position: FloatArray | None = None
    by_rate: FloatArray | None = None
    by_acceleration: FloatArray | None = None

    def squares(self, weights: FloatArray, motions: int = 1) -> FloatArray:
        """Sum of squares (S,), integrated over time."""
        return np.asarray(np.einsum("jsk,jsk,k->s", self.value, self.value, weights))


Residuals: TypeAlias = list["Residual | JointResidual"]
