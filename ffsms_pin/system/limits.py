"""Limits of the joints."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ffsms_pin.checks import LARGEST_POSITIVE, SMALLEST_POSITIVE, FloatArray, frozen, per_joint, vector
from ffsms_pin.errors import InvalidValue
from ffsms_pin.system.joints import JointLayout

__all__ = ["ACCELERATION_PER_VELOCITY", "JointLimits", "limits_of", "within_turns"]

_FAR = 25.2  # [rad] four turns: the position limit of a turning joint beyond this means "none"
# A URDF has no acceleration limit. The paper's are 28.65 deg/s^2 for 22.92 deg/s.
ACCELERATION_PER_VELOCITY = 1.25  # [1/s]


@dataclass(frozen=True, eq=False)  # arrays have no single truth value to compare by
class JointLimits:
    """Limits of n joints, each an array of shape (n,); infinite where there is none.

    URDFs write "no limit" as all sorts of large numbers: one beyond 1e12 is taken as infinite, and a robot
    takes a position beyond four turns of a joint that turns so. A rate, an acceleration or a torque below
    1e-12 is refused, for nothing could move within it.

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
        object.__setattr__(self, "lower", _entries("lower", self.lower))
        for field in fields(self):
            array = _entries(field.name, getattr(self, field.name))
            if array.shape != self.lower.shape:
                raise InvalidValue(
                    f"limits.{field.name}",
                    array,
                    f"must have one entry a joint, as lower has {self.lower.size}",
                )
            object.__setattr__(self, field.name, frozen(array))
        for name in ("velocity", "acceleration", "torque"):
            if not (getattr(self, name) > 0.0).all():
                raise InvalidValue(f"limits.{name}", getattr(self, name), "must be above zero")
            if not (getattr(self, name) >= SMALLEST_POSITIVE).all():
                raise InvalidValue(
                    f"limits.{name}", getattr(self, name), f"must be at least {SMALLEST_POSITIVE:g}"
                )
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

    @cached_property
    def table(self) -> FloatArray:
        """Lower, upper, velocity, acceleration, one below the other (4, n)."""
        return frozen(np.array([self.lower, self.upper, self.velocity, self.acceleration]))

    @cached_property
    def each(self) -> FloatArray:
        """A row for each joint (n, n), read-only: the unit matrix."""
        return frozen(np.eye(self.lower.size))

    def violation(self, positions: ArrayLike) -> FloatArray:
        """How far each joint is outside its position limits (n,), zero inside; (k, n) for rows of them."""
        n = self.lower.size
        rows = (
            isinstance(positions, np.ndarray)
            and positions.dtype == np.float64
            and positions.shape[-1:] == (n,)
        )
        q: FloatArray = np.asarray(positions) if rows else vector("positions", positions, n)
        return np.maximum(0.0, np.maximum(self.lower - q, q - self.upper))


def limits_of(model: Any, layout: JointLayout, acceleration: ArrayLike | None) -> JointLimits:
    """Limits of a Pinocchio model's joints. It holds none of acceleration: see `SpaceManipulator`."""
    lower, upper = layout.position_limits(model)
    velocity = np.array(model.upperVelocityLimit[6:])  # the lower one has the wrong sign in Pinocchio 4.1
    torque = np.array(model.upperEffortLimit[6:])
    velocity[velocity > LARGEST_POSITIVE] = np.inf  # Pinocchio writes "no limit" as the largest float
    if acceleration is None:
        limit = ACCELERATION_PER_VELOCITY * velocity
    else:
        limit = per_joint("acceleration", acceleration, layout.n, "rad/s^2")
    return JointLimits(lower, upper, velocity, limit, torque)


def within_turns(limits: JointLimits, turns: NDArray[np.bool_]) -> JointLimits:
    """The same limits without positions beyond four turns of the joints that turn, (n,)."""
    lower, upper = (
        np.where(turns & (np.abs(bound) > _FAR), np.copysign(np.inf, bound), bound)
        for bound in (limits.lower, limits.upper)
    )
    same = np.array_equal(lower, limits.lower) and np.array_equal(upper, limits.upper)
    return limits if same else replace(limits, lower=lower, upper=upper)


def _entries(name: str, value: Any) -> FloatArray:
    """A vector of numbers, infinite beyond the largest that counts as a limit."""
    try:
        given = np.asarray(value)
    except (TypeError, ValueError, OverflowError):  # rows of different lengths
        given = np.empty(0, dtype=object)
    if given.dtype.kind not in "fiu" or given.ndim != 1 or np.isnan(given).any():
        raise InvalidValue(f"limits.{name}", value, "must be a vector without NaN, one entry a joint")
    array = np.array(given, dtype=np.float64)
    array[array > LARGEST_POSITIVE] = np.inf
    array[array < -LARGEST_POSITIVE] = -np.inf
    return array
