"""The classes `Mechanism` (a Pinocchio model with a free-flyer root), `JointLayout` and `RobotLimits`."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Annotated, Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ffsms_pin.checks import (
    LARGEST_POSITIVE,
    LONGEST,
    SMALLEST_POSITIVE,
    FloatArray,
    com_problem,
    frozen,
    inertia_problem,
    per_joint,
    reals,
    vector,
)
from ffsms_pin.errors import (
    AmbiguousEndEffector,
    FrameNotFound,
    InvalidInertia,
    InvalidUrdf,
    InvalidValue,
    UnsupportedJoint,
)
from ffsms_pin.options import Angle, Real, Unit, values_per_joint
from ffsms_pin.system.urdf_elements import tool_among
from ffsms_pin.threads import Unchanging

FOUR_TURNS = 25.2  # [rad] a larger position limit of a revolute joint is read as no limit
# URDFs have no acceleration limits; the ratio is that of the paper's limits, 28.65 deg/s^2 and 22.92 deg/s.
ACCELERATION_PER_VELOCITY = 1.25  # [1/s]
_LAST = (pin.FrameType.BODY, pin.FrameType.OP_FRAME)


class JointUnit(NamedTuple):
    """A unit for display, and the factor from radians or metres to the unit."""

    name: str
    factor: float


class JointLayout:
    """A map of n joint positions to Pinocchio's q and back.

    A continuous joint has two entries of q (cosine and sine), any other joint has one. Every joint has one
    entry of v.

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
        True for revolute joints, False for prismatic joints.
    plain : bool
        True if q[7:] are the joint positions themselves (no continuous joint).
    """

    def __init__(self, model: Any) -> None:
        if model.njoints < 2 or (model.joints[1].nq, model.joints[1].nv) != (7, 6):
            message = "the model's first joint is not a free-flyer; build the model with"
            remedy = "pinocchio.JointModelFreeFlyer() as its root joint, or put the arm on a satellite"
            raise UnsupportedJoint(model.name, f"{message} {remedy}: ffsms_pin.mount")
        if not model.jointPlacements[1].isIdentity():
            message = (
                "the free-flyer is not placed at the inertial origin; its placement must be the identity"
            )
            raise UnsupportedJoint(model.name, message)
        if model.njoints == 2:
            raise UnsupportedJoint(model.name, "the robot has no joint that moves; an arm needs at least one")
        joints, self.names = list(model.joints)[2:], [str(name) for name in model.names][2:]
        for j, (joint, name) in enumerate(zip(joints, self.names, strict=True), start=2):
            message = ""
            if joint.nv != 1 or joint.nq not in (1, 2):
                message = f"has {joint.nv} degrees of freedom; only joints with one are supported"
            elif joint.shortname().startswith("JointModelH"):
                message = "is helical; only revolute and prismatic joints are supported"
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

    def largest(self, values: FloatArray) -> dict[str, float]:
        """Return the largest magnitude of positions or rates (n,), by unit.

        The units are "deg" for revolute joints and "m" for prismatic joints, if the robot has such joints.
        """
        largest = dict[str, float]()
        for value, (unit, factor) in zip(np.abs(values).tolist(), self.units, strict=True):
            largest[unit] = max(largest.get(unit, 0.0), factor * value)
        return largest

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
        """Return the joint positions of q (nq,) minus `positions` (n,).

        The difference of continuous joints is wrapped to [-pi, pi). The difference of other joints is not
        wrapped, because these joints may turn by more than one turn.
        """
        if self.plain:
            return q[7:] - positions
        difference = self.positions(q) - positions
        wrapped = (difference + math.pi) % (2.0 * math.pi) - math.pi
        return np.where(self.continuous, wrapped, difference)

    def check_circles(self, name: str, q: FloatArray) -> None:
        """Check that the cosine and sine of every continuous joint in q (nq,) have unit norm to 1e-6."""
        for k, circle, joint in zip(self.index, self.continuous, self.names, strict=True):
            if circle and abs(np.hypot(q[k], q[k + 1]) - 1.0) > 1e-6:
                part = f"{name}[{k}:{k + 2}], the cosine and sine of joint '{joint}',"
                raise InvalidValue(part, q[k : k + 2], "must have length 1")

    @staticmethod
    def body_name(model: Any, joint: int) -> str:
        """Return the name of the first link or other frame on a joint, or the joint's name if there is none.

        Frames with the name of a joint do not count.
        """
        for frame in model.frames:
            if frame.parentJoint == joint and frame.name not in model.names:
                return str(frame.name)
        return str(model.names[joint])


@dataclass(frozen=True, eq=False)  # arrays cannot be compared with ==
class RobotLimits:
    """The limits of a robot's n joints, each an array of shape (n,); infinite if there is no limit.

    URDFs contain various large numbers that mean "no limit". A limit whose magnitude is above 1e12 becomes
    infinite. In a robot, a position limit of a revolute joint beyond four turns becomes infinite, too. Limits
    of rate, acceleration and torque below 1e-12, and lower limits not below the upper limits, are refused.

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
                message = f"must have one entry per joint; lower has {self.lower.size}"
                raise InvalidValue(name, array, message)
            if field.name not in ("lower", "upper") and not (array >= SMALLEST_POSITIVE).all():
                raise InvalidValue(name, array, f"must be above zero, and at least {SMALLEST_POSITIVE:g}")
            object.__setattr__(self, field.name, frozen(array))
        for i in np.flatnonzero(self.lower >= self.upper):
            message = "are equal or in the wrong order: lower must be below upper"
            raise InvalidValue(f"limits of joint {i + 1}", (self.lower.item(i), self.upper.item(i)), message)

    def __reduce__(self) -> tuple[Any, ...]:
        # Copies are constructed from the arrays, because numpy's own copies are writable.
        return RobotLimits, tuple(getattr(self, field.name) for field in fields(self))

    @cached_property
    def table(self) -> FloatArray:
        """The limits as an array (4, n) with the rows lower, upper, velocity and acceleration."""
        return frozen(np.array([self.lower, self.upper, self.velocity, self.acceleration]))

    def violation(self, positions: ArrayLike) -> FloatArray:
        """Return the violation of the position limits at positions (..., n), zero within them [rad or m]."""
        q = np.asarray(positions, dtype=np.float64)
        outside: FloatArray = np.maximum(0.0, np.maximum(self.lower - q, q - self.upper))
        return outside


def limits_of(model: Any, layout: JointLayout, acceleration: ArrayLike | None) -> RobotLimits:
    """Return the limits of the joints of a Pinocchio model.

    `acceleration` is the argument of `SpaceManipulator`; None means 1.25 /s times the rate limits.
    """
    unlimited, index = np.where(layout.continuous, np.inf, 0.0), layout.index
    lower, upper = model.lowerPositionLimit[index] - unlimited, model.upperPositionLimit[index] + unlimited
    velocity = np.array(model.upperVelocityLimit[6:])  # lowerVelocityLimit has a wrong sign in Pinocchio 4.1
    torque = np.array(model.upperEffortLimit[6:])
    velocity[velocity > LARGEST_POSITIVE] = np.inf  # Pinocchio writes "no limit" as the largest float
    if acceleration is None:
        limit = ACCELERATION_PER_VELOCITY * velocity
    else:
        limit = per_joint("acceleration", acceleration, layout.n, "rad/s^2")
    return RobotLimits(lower, upper, velocity, limit, torque)


def within_turns(limits: RobotLimits, turns: NDArray[np.bool_]) -> RobotLimits:
    """Return the limits, with infinite position limits in place of those beyond four turns.

    Only the limits of revolute joints, for which `turns` (n,) is True, are replaced.
    """
    lower, upper = (
        np.where(turns & (np.abs(bound) > FOUR_TURNS), np.copysign(np.inf, bound), bound)
        for bound in (limits.lower, limits.upper)
    )
    same = np.array_equal(lower, limits.lower) and np.array_equal(upper, limits.upper)
    return limits if same else replace(limits, lower=lower, upper=upper)


def _entries(name: str, value: Any) -> FloatArray:
    """Check a limit and return its array (n,), with magnitudes above `LARGEST_POSITIVE` infinite."""
    array = np.array(reals(f"limits.{name}", value))
    if array.ndim != 1 or np.isnan(array).any():
        raise InvalidValue(f"limits.{name}", value, "must be a vector without NaN, one entry per joint")
    array[array > LARGEST_POSITIVE] = np.inf
    array[array < -LARGEST_POSITIVE] = -np.inf
    return array


class Mechanism(Unchanging):
    """An immutable model with a free-flyer root and an end-effector frame.

    Functions of `ffsms_pin.system.dynamics` take a mechanism. Users work with the subclass
    `SpaceManipulator`.

    Attributes
    ----------
    model : pinocchio.Model
        A copy of the given model, with zero gravity; its first joint is a free-flyer.
    layout : JointLayout
        Indices of the joints in Pinocchio's q.
    n : int
        Number of actuated joints.
    nq : int
        Length of q: 7 for the base, then 1 for each joint, or 2 for a continuous joint.
    nv : int
        Length of v: 6 + n.
    base_com : ndarray, shape (3,)
        Centre of mass of the base body in the root frame [m].
    """

    _complete = False
    _refused = (
        "a robot cannot be changed (tried to {} '{}'); make another one: with_limits(limits),"
        " with_inertias(inertias), with_actuators(wheels, thrusters), or load it with other arguments"
    )

    def __init__(self, model: Any, end_effector: str | None = None) -> None:
        if not isinstance(model, pin.Model):
            raise InvalidValue("model", model, "must be a pinocchio.Model")
        self.model = model.copy()
        self.model.gravity = pin.Motion.Zero()
        self.layout = JointLayout(self.model)
        self.n: int = self.layout.n
        self.nq, self.nv = int(self.model.nq), int(self.model.nv)
        if end_effector is None and len(tips := last_frames(self.model)) == 1:
            (end_effector,) = tips
        self._end_effector = end_effector
        self._frame_id = None if end_effector is None else frame_index(self.model, end_effector)
        self.base_com: FloatArray = frozen(np.array(self.model.inertias[1].lever))
        self._scratch = _Scratch(self.model)
        _check_bodies(self.model, self.layout)

    @property
    def end_effector(self) -> str:
        """The name of the end-effector frame.

        Raises
        ------
        AmbiguousEndEffector
            The robot has several last frames, and no end effector was chosen (`with_end_effector`).
        """
        if self._end_effector is None:
            raise AmbiguousEndEffector(self.end_effectors)
        return self._end_effector

    @property
    def frame_id(self) -> int:
        """The index of the end-effector frame in Pinocchio."""
        if self._frame_id is None:
            raise AmbiguousEndEffector(self.end_effectors)
        return self._frame_id

    @property
    def tip_joint(self) -> int:
        """The index in Pinocchio of the joint that carries the end effector; 1 is the free-flyer."""
        return int(self.model.frames[self.frame_id].parentJoint)

    @property
    def end_effectors(self) -> list[str]:
        """The names of the last frames of the arms, see `last_frames`.

        If the end-effector frame is on the last joint of an arm, it replaces the last frame of that arm.
        """
        return last_frames(self.model, self._frame_id)

    def checked_configuration(self, name: str, q: ArrayLike) -> FloatArray:
        """Check a configuration and return a copy (nq,).

        The numbers must be finite, with magnitudes up to 1e9. The quaternion, and the cosine and sine of each
        continuous joint, must have unit norm to 1e-6.
        """
        if np.asarray(q, dtype=object).shape == (self.n,):
            text = f"must have {self.nq} entries, the base first; sms.configuration(joints) returns them"
            raise InvalidValue(name, q, f"{text} for {self.n} joint positions")
        array = vector(name, q, self.nq)
        norm = math.hypot(*array[3:7].tolist())
        if abs(norm - 1.0) > 1e-6:
            part = f"{name}[3:7], the base quaternion (x, y, z, w),"
            raise InvalidValue(part, array[3:7], f"must have length 1 but has {norm:.6g}")
        if not self.layout.plain:
            self.layout.check_circles(name, array)
        return array


class _Scratch(threading.local):
    """The Pinocchio data of a model, one object per thread."""

    def __init__(self, model: Any) -> None:
        self.data = model.createData()


def _check_bodies(model: Any, layout: JointLayout) -> None:
    """Check the bodies of a model.

    Raises `InvalidInertia` for a mass, inertia or centre of mass that no rigid body has, or for a body that
    makes the inertia matrix singular; `InvalidUrdf` if the joint of a body with mass is too far away.
    """
    for j in range(1, model.njoints):
        body = model.inertias[j]
        name, mass = layout.body_name(model, j), float(body.mass)
        tensor, com = np.array(body.inertia), np.array(body.lever)
        finite = math.isfinite(mass) and np.isfinite(com).all() and np.isfinite(tensor).all()
        if mass == 0.0 and not tensor.any() and j > 1 and _carried(model, j):
            continue  # a massless link between two joints, such as in a universal joint
        if not finite or mass <= 0.0 or np.linalg.eigvalsh(tensor)[0] <= 0.0:
            message = f"moves but its inertia is not positive definite (mass {mass:g} kg)"
            raise InvalidInertia(model.name, name, message)
        if problem := inertia_problem(mass, tensor):
            raise InvalidInertia(model.name, name, problem)
        if problem := com_problem(mass, tensor, com):
            raise InvalidInertia(model.name, name, f"has a centre of mass that {problem}")
        distance = math.hypot(*np.array(model.jointPlacements[j].translation).tolist())
        if not distance <= LONGEST:
            message = f"joint '{model.names[j]}' lies {distance:.3g} m from the joint before it"
            raise InvalidUrdf(
                model.name, f"{message}; at most {LONGEST:g} m are allowed: check that lengths are in metres"
            )


def _carried(model: Any, j: int) -> bool:
    """Return whether the inertia matrix is regular although the body of joint j has no mass.

    The joints from j to the next body with a mass must move that body independently, unlike two coaxial
    revolute joints or two parallel prismatic joints. If the joints branch before that body, the result is
    False.
    """
    carried = [k for k in range(j + 1, model.njoints) if model.parents[k] == j]
    if len(carried) != 1:
        return False
    (k,) = carried
    while model.inertias[k].mass == 0.0:
        further = [i for i in range(k + 1, model.njoints) if model.parents[i] == k]
        if len(further) != 1:
            return False
        (k,) = further
    data, rng = model.createData(), np.random.default_rng(1)
    q = pin.neutral(model)
    for _ in range(3):
        q = pin.integrate(model, q, rng.uniform(-1.0, 1.0, model.nv))
        pin.computeJointJacobians(model, data, q)
        J = pin.getJointJacobian(model, data, k, pin.ReferenceFrame.LOCAL)
        connecting = [i for i in model.supports[k] if i >= j]
        columns = J[:, [model.joints[i].idx_v for i in connecting]]
        columns = columns / np.linalg.norm(columns, axis=0)
        if np.linalg.svd(columns, compute_uv=False)[-1] > 1e-6:
            return True
    return False


def scratch(robot: Mechanism) -> Any:
    """Return the calling thread's Pinocchio data of a robot, for a calculation within the library.

    A later calculation may overwrite the data, so a function must copy its result.
    """
    return robot._scratch.data


def last_frames(model: Any, chosen: int | None = None) -> list[str]:
    """Return the names of the last frames of the arms, which are on joints that carry no other joint.

    For each such joint the result has the frame with index `chosen` if that frame is on the joint, else the
    last frame if it is the only one or the one with a tool's name, else all last frames of the joint.
    """
    carriers = set(model.parents)
    onward = {frame.parentFrame for frame in model.frames}
    names: dict[int, list[str]] = {j: [] for j in range(2, model.njoints) if j not in carriers}
    for i, frame in enumerate(model.frames):
        if frame.parentJoint in names and frame.type in _LAST and i not in onward:
            names[frame.parentJoint].append(frame.name)
    if chosen is not None and (j := model.frames[chosen].parentJoint) in names:
        names[j] = [model.frames[chosen].name]
    last = list[str]()
    for j, tips in names.items():
        tool = tool_among(tips)
        # The joint's own frame is used if it has no body frame and no operational frame.
        last += [tool] if tool else tips or [model.frames[model.getFrameId(model.names[j])].name]
    return last


def frame_index(model: Any, name: str) -> int:
    """Return the index of the frame `name`; a link has precedence over a joint with the same name.

    Raises `FrameNotFound` if no frame on the base or an arm has this name.
    """
    frames = [(i, frame) for i, frame in enumerate(model.frames) if frame.parentJoint > 0]
    named = [(i, frame) for i, frame in frames if isinstance(name, str) and frame.name == name]
    if not named:
        raise FrameNotFound(str(name), list(dict.fromkeys(frame.name for _, frame in frames)))
    return next((i for i, frame in named if frame.type == pin.FrameType.BODY), named[0][0])
