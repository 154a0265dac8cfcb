"""Limits of the joints."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, frozen
from ffsms_pin.errors import InvalidValue

__all__ = ["ACCELERATION_PER_VELOCITY", "JointLimits"]

# A URDF has no acceleration limit. The paper's are 28.65 deg/s^2 for 22.92 deg/s.
ACCELERATION_PER_VELOCITY = 1.25  # [1/s]


@dataclass(frozen=True, eq=False)  # arrays have no single truth value to compare by
class JointLimits:
    """Limits of n joints, each an array of shape (n,); infinite where there is none.

    Attributes
    ----------
    lower, upper : ndarray
        Position [rad, or m for a prismatic joint].
    velocity : ndarray
        Size of the rate [rad/s].
    acceleration : ndarray
        Size of the acceleration [rad/s^2].
    torque : ndarray
        Size of the torque [N m].
    """

    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray

    def __post_init__(self) -> None:
        for field in fields(self):
            array = np.array(getattr(self, field.name), dtype=np.float64)
            if array.ndim != 1 or array.shape != np.shape(self.lower) or np.isnan(array).any():
                raise InvalidValue(
                    f"limits.{field.name}", array, "must be a vector without NaN, one entry a joint"
                )
            object.__setattr__(self, field.name, frozen(array))
        for name in ("velocity", "acceleration", "torque"):
            if not (getattr(self, name) > 0.0).all():
                raise InvalidValue(f"limits.{name}", getattr(self, name), "must be above zero")
        wrong = np.flatnonzero(self.lower >= self.upper)
        if wrong.size:
            i = int(wrong[0])
            raise InvalidValue(
                f"limits of joint {i + 1}",
                (float(self.lower[i]), float(self.upper[i])),
                "are the wrong way round: lower must be below upper",
            )

    def __reduce__(self) -> tuple[Any, ...]:
        # A copy checks and locks its arrays again: numpy's own copies are writable.
        return JointLimits, tuple(getattr(self, field.name) for field in fields(self))

    def violation(self, positions: ArrayLike) -> FloatArray:
        """How far each joint is outside its position limits, zero inside; shape (n,)."""
        q = np.asarray(positions, dtype=np.float64)
        return np.maximum(0.0, np.maximum(self.lower - q, q - self.upper))
