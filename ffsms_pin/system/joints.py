"""The indices of the actuated joints in Pinocchio's q and v, and their limits."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ffsms_pin.checks import (
    LARGEST_POSITIVE,
    SMALLEST_POSITIVE,
    FloatArray,
    frozen,
    per_joint,
    reals,
)
from ffsms_pin.errors import InvalidValue, UnsupportedJoint
from ffsms_pin.options import Angle, Real, Unit, values_per_joint

FOUR_TURNS = 25.2  # [rad] four turns: the position limit of a turning joint beyond this means "none"
# A URDF has no acceleration limit. The paper's are 28.65 deg/s^2 for 22.92 deg/s.
ACCELERATION_PER_VELOCITY = 1.25  # [1/s]


class JointUnit(NamedTuple):
    """A display unit, and the number of these units in one radian or metre."""

    name: str
    factor: float


class JointLayout:
    """A map of n joint positions to Pinocchio's q and back.

    A continuous joint takes two entries of q (cosine and sine), every other one entry; each has one in v.

    Attributes
    ----------
    n : int
        Number of actuated joints.
    names : list of str
        Names of the joints, in the order of v.
    index : ndarray of int, shape (n,)
        Index of each joint position in q; for a continuous joint the index of its cosine.
    continuous : ndarray of bool, shape (n,)
        True for continuous joints, whose positions repeat after one turn.
    turns : ndarray of bool, shape (n,)
        True for joints that turn; the others slide.
    plain : bool
        True if q[7:] are the joint positions themselves (no continuous joint).
    """

    def __init__(self, model: Any) -> None:
        if model.njoints < 2 or (model.joints[1].nq, model.joints[1].nv) != (7, 6):
            raise UnsupportedJoint(model.name, "the model's first joint is not a free-flyer")
        if not model.jointPlacements[1].isIdentity():
            raise UnsupportedJoint(model.name, "the free-flyer is not placed at the inertial origin")
        if model.njoints == 2:
            raise UnsupportedJoint(model.name, "the robot has no joint that moves; an arm needs at least one")
        joints, self.names = list(model.joints)[2:], [str(name) for name in model.names][2:]
        for j, (joint, name) in enumerate(zip(joints, self.names, strict=True), start=2):
            message = ""
            if joint.nv != 1 or joint.nq not in (1, 2):
                message = f"has {joint.nv} degrees of freedom; one is supported"
            elif model.parents[j] == 0:
                message = "is not carried by the free-flyer"
            elif model.parents[j] not in model.supports[j - 1]:
                # Pinocchio's inertia matrix is silently wrong for any other order.
                message = f"belongs to a branch before joint '{model.names[j - 1]}'; "
                message += "add the joints of a branch one after the other (depth first)"
            if message:
                raise UnsupportedJoint(model.name, f"joint '{name}' {message}")
        self.n = len(self.names)
        self.index = np.array([joint.idx_q for joint in joints])
        self.continuous = np.array([joint.nq == 2 for joint in joints])
        self.turns = np.array([not joint.shortname().startswith("JointModelP") for joint in joints])
        for array in (self.continuous, self.turns):
            array.setflags(write=False)
        self.plain = not self.continuous.any()

    @property
    def units(self) -> list[JointUnit]:
        """The unit of each joint's position."""
        return [JointUnit("deg", math.degrees(1.0)) if turns else JointUnit("m", 1.0) for turns in self.turns]

    def positions(self, q: FloatArray) -> FloatArray:
        """Return the joint positions (n,) of a configuration (nq,)."""
        if self.plain:
            return q[7:].copy()
        first, second = q[self.index], q[self.index + self.continuous]
        return np.asarray(np.where(self.continuous, np.arctan2(second, first), first))

    def set_positions(self, q: FloatArray, positions: FloatArray) -> None:
        """Write joint positions (..., n) into configurations (..., nq), in place."""
        if self.plain:
            q[..., 7:] = positions
            return
        circles = self.continuous
        q[..., self.index] = np.where(circles, np.cos(positions), positions)
        q[..., self.index[circles] + 1] = np.sin(positions[..., circles])

    def difference(self, q: FloatArray, positions: FloatArray) -> FloatArray:
        """Return the joint positions of q (nq,) less `positions` (n,).

        For continuous joints it is the difference of least size; other joints may turn by more than one turn,
        so their difference is not reduced.
        """
        if self.plain:
            return q[7:] - positions
        difference = self.positions(q) - positions
        wrapped = (difference + math.pi) % (2.0 * math.pi) - math.pi
        return np.where(self.continuous, wrapped, difference)

    def check_circles(self, name: str, q: FloatArray) -> None:
        """Check that the cosine and sine of every continuous joint in q (nq,) have unit norm."""
        for k, circle, joint in zip(self.index, self.continuous, self.names, strict=True):
            if circle and abs(np.hypot(q[k], q[k + 1]) - 1.0) > 1e-6:
                part = f"{name}[{k}:{k + 2}], the cosine and sine of joint '{joint}',"
                raise InvalidValue(part, q[k : k + 2], "must have length 1")

    @staticmethod
    def body_name(model: Any, joint: int) -> str:
        """Return the name of the joint's first body frame, for messages."""
        for frame in model.frames:
            if frame.parentJoint == joint and frame.name not in model.names:
                return str(frame.name)
        return str(model.names[joint])


@dataclass(frozen=True, eq=False)  # arrays cannot be compared with ==
class RobotLimits:
    """The limits of a robot's n joints, each an array of shape (n,); infinite if there is no limit.

    URDFs contain various large numbers that mean "no limit". A limit above 1e12 becomes infinite, and so does
    a position limit beyond four turns of a joint that turns. A limit of rate, acceleration or torque below
    1e-12 is refused, because no joint could move within it.

    Attributes
    ----------
    lower, upper : ndarray
        Position limits [rad or m].
    velocity : ndarray
        Largest magnitude of the rate [rad/s or m/s].
    acceleration : ndarray
        Largest magnitude of the acceleration [rad/s^2 or m/s^2].
    torque : ndarray
        Largest magnitude of the torque [N m or N].
    """

    lower: Annotated[FloatArray, values_per_joint(Real()), Angle("rad or m")]
    upper: Annotated[FloatArray, values_per_joint(Real()), Angle("rad or m")]
    velocity: Annotated[FloatArray, values_per_joint(Real(SMALLEST_POSITIVE)), Angle("rad/s or m/s")]
    acceleration: Annotated[FloatArray, values_per_joint(Real(SMALLEST_POSITIVE)), Angle("rad/s² or m/s²")]
    torque: Annotated[FloatArray, values_per_joint(Real(SMALLEST_POSITIVE)), Unit("N m or N")]

    def __post_init__(self) -> None:
        for field in fields(self):
            name, array = f"limits.{field.name}", _entries(field.name, getattr(self, field.name))
            if array.shape != np.shape(self.lower):
                message = f"must have one entry a joint, as lower has {self.lower.size}"
                raise InvalidValue(name, array, message)
            if field.name not in ("lower", "upper") and not (array >= SMALLEST_POSITIVE).all():
                raise InvalidValue(name, array, f"must be above zero, and at least {SMALLEST_POSITIVE:g}")
            object.__setattr__(self, field.name, frozen(array))
        for i in np.flatnonzero(self.lower >= self.upper):
            message = "are in the wrong order: lower must be below upper"
            raise InvalidValue(f"limits of joint {i + 1}", (self.lower.item(i), self.upper.item(i)), message)

    def __reduce__(self) -> tuple[Any, ...]:
        # A copy checks its arrays and makes them read-only again, because numpy's copies are writable.
        return RobotLimits, tuple(getattr(self, field.name) for field in fields(self))

    @cached_property
    def table(self) -> FloatArray:
        """The limits as an array (4, n) with the rows lower, upper, velocity and acceleration."""
        return frozen(np.array([self.lower, self.upper, self.velocity, self.acceleration]))

    def violation(self, positions: ArrayLike) -> FloatArray:
        """Return how far each joint is outside its position limits (n,), zero inside; (k, n) for rows."""
        q = np.asarray(positions, dtype=np.float64)
        outside: FloatArray = np.maximum(0.0, np.maximum(self.lower - q, q - self.upper))
        return outside


def limits_of(model: Any, layout: JointLayout, acceleration: ArrayLike | None) -> RobotLimits:
    """Return the limits of a Pinocchio model's joints; it has no acceleration limits (`SpaceManipulator`)."""
    unlimited, index = np.where(layout.continuous, np.inf, 0.0), layout.index
    lower, upper = model.lowerPositionLimit[index] - unlimited, model.upperPositionLimit[index] + unlimited
    velocity = np.array(model.upperVelocityLimit[6:])  # the lower one has the wrong sign in Pinocchio 4.1
    torque = np.array(model.upperEffortLimit[6:])
    velocity[velocity > LARGEST_POSITIVE] = np.inf  # Pinocchio writes "no limit" as the largest float
    if acceleration is None:
        limit = ACCELERATION_PER_VELOCITY * velocity
    else:
        limit = per_joint("acceleration", acceleration, layout.n, "rad/s^2")
    return RobotLimits(lower, upper, velocity, limit, torque)


def within_turns(limits: RobotLimits, turns: NDArray[np.bool_]) -> RobotLimits:
    """Return the limits, with infinite position limits for joints that `turns` by more than four turns."""
    lower, upper = (
        np.where(turns & (np.abs(bound) > FOUR_TURNS), np.copysign(np.inf, bound), bound)
        for bound in (limits.lower, limits.upper)
    )
    same = np.array_equal(lower, limits.lower) and np.array_equal(upper, limits.upper)
    return limits if same else replace(limits, lower=lower, upper=upper)


def _entries(name: str, value: Any) -> FloatArray:
    """Return a vector of numbers, infinite where they exceed the largest number read as a limit."""
    array = np.array(reals(f"limits.{name}", value))
    if array.ndim != 1 or np.isnan(array).any():
        raise InvalidValue(f"limits.{name}", value, "must be a vector without NaN, one entry a joint")
    array[array > LARGEST_POSITIVE] = np.inf
    array[array < -LARGEST_POSITIVE] = -np.inf
    return array
