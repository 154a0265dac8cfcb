"""Goals of the end effector: fixed goals, moving goals, and goals derived from other goals.

A place is the desired pose, or position only, of a frame of the robot. The pose error of the frame is a
displacement, and a rotation if the place has an attitude.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin import checks
from ffsms_pin.checks import FloatArray, frozen, vector
from ffsms_pin.client import FreeBody
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.derivatives import BASE, INERTIAL, FrameVariable, Variable
from ffsms_pin.options import Angle, Positive, Unit
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system.batch.stacks import diagonal, dot

if TYPE_CHECKING:
    from ffsms_pin.opt.limits.limit import Limit

_TINY = 1e-12  # a vector shorter than this has no direction
_OPPOSITE = 1e-8  # [rad] within this angle of the opposite direction the rotation of an axis is not unique


class PoseError(NamedTuple):
    """The pose error of a frame: displacement (3, S, K) [m] and rotation vector (3, S, K) [rad].

    The error is in the axes `Place.on`. The displacement leads to the desired position, the rotation vector
    to the nearest admissible attitude. `rotation` is None if any attitude is admissible.
    """

    displacement: Variable
    rotation: Variable | None = None

    @property
    def parts(self) -> list[Variable]:
        """The displacement, and the rotation unless any attitude is admissible."""
        return [self.displacement] if self.rotation is None else [self.displacement, self.rotation]

    @property
    def vector(self) -> FloatArray:
        """The rotation (3, S, K) as a plain array; zero if any attitude is admissible."""
        return np.zeros_like(self.displacement.value) if self.rotation is None else self.rotation.value

    @property
    def distance(self) -> FloatArray:
        """The length of the displacement (S, K) [m]."""
        return np.sqrt(dot(self.displacement.value, self.displacement.value))

    @property
    def angle(self) -> FloatArray:
        """The angle of the rotation (S, K) [rad]."""
        return np.sqrt(dot(self.vector, self.vector))

    def text(self) -> str:
        """Describe the largest distance, and the largest angle if the attitude is constrained."""
        angle = "" if self.rotation is None else f", turned by {np.degrees(self.angle.max()):.2f} deg,"
        return f"{1e3 * self.distance.max():.1f} mm{angle}"


@dataclass(frozen=True, eq=False)
class Place:
    """The desired pose of a frame of the robot at one time, or at K times as the last axis of the arrays."""

    position: FloatArray  # (3,) [m]
    rotation: FloatArray | None = None  # (3, 3); None: any attitude
    velocity: FloatArray | None = None  # (3,) [m/s]; None: not constrained
    angular_velocity: FloatArray | None = None  # (3,) [rad/s]; None: not constrained
    free_axis: FloatArray | None = None  # (3,) unit vector in the frame's axes; rotation about it is free
    on: str = INERTIAL  # the axes of the place; BASE: those of the base link, with which the place moves

    @property
    def moves_with_base(self) -> bool:
        """True if the place is fixed to the robot's base."""
        return self.on == BASE

    @property
    def plain(self) -> bool:
        """True if the place has inertial axes and no free axis, so that single steps support it."""
        return self.on == INERTIAL and self.free_axis is None

    @property
    def rests(self) -> bool:
        """True if the place has no desired velocity."""
        return self.velocity is None and self.angular_velocity is None

    @property
    def twist(self) -> FloatArray:
        """The desired velocity and angular velocity (6,) [m/s; rad/s]; zero if they are not constrained."""
        parts = (self.velocity, self.angular_velocity)
        return np.concatenate([np.zeros(3) if part is None else part for part in parts])

    @property
    def attitude(self) -> FloatArray:
        """The desired attitude (3, 3); NaN if any attitude is admissible."""
        return np.full((3, 3), np.nan) if self.rotation is None else self.rotation

    def moving(self, behind: Place, ahead: Place, time: float) -> Place:
        """Return the place with the mean velocities of a motion from `behind` to `ahead` in `time` [s]."""
        angular_velocity = None
        if behind.rotation is not None and ahead.rotation is not None:
            angular_velocity = pin.log3(ahead.rotation @ behind.rotation.T) / time
        return replace(
            self, velocity=(ahead.position - behind.position) / time, angular_velocity=angular_velocity
        )

    def pose_error(self, frame: FrameVariable) -> PoseError:
        """Return the pose error of a frame (3, S, K) that is in the axes `on`, see `Variables.frame`."""
        displacement: Variable = np.subtract(self.position.reshape(3, 1, -1), frame)  # type: ignore[assignment]
        if self.rotation is None:
            return PoseError(displacement)
        if self.free_axis is None:
            return PoseError(displacement, -frame.rotation_vector_from(self.rotation))
        desired = np.einsum("xy...,y->x...", self.rotation, self.free_axis).reshape(3, 1, -1)
        now = frame.axis(self.free_axis)
        across, cosine = now.cross(desired), now.dot(desired)
        # A rotation by pi may be about any perpendicular axis.
        opposite = (across.norm().value < _OPPOSITE) & (cosine.value < 0.0)
        aside = np.cross(desired, np.eye(3)[:, np.abs(desired).argmin(axis=0)], axis=0)
        across = across * np.where(opposite, 0.0, 1.0) + np.where(opposite, aside, 0.0)
        sine = across.norm(_TINY)
        angle = np.arctan2(sine * np.where(opposite, 0.0, 1.0), cosine)
        return PoseError(displacement, across * (angle / sine))

    def without_free_axis(self, columns: FloatArray) -> FloatArray:
        """Return angular velocities (3, ...) without their component along the free axis, if there is one.

        The place must be at one time. If it has no attitude, the result is empty (0, ...).
        """
        if self.rotation is None:
            return columns[:0]
        if self.free_axis is None:
            return columns
        axis = self.rotation @ self.free_axis
        about: FloatArray = np.einsum("x,y,y...->x...", axis, axis, columns)
        return columns - about

    def in_axes(self, pose: Any, q: FloatArray) -> FrameVariable:
        """Return a pose (pinocchio.SE3, inertial axes) as a frame in the axes `on`; q is (nq,)."""
        return frame_at(pin.XYZQUATToSE3(q[:7]).actInv(pose) if self.moves_with_base else pose)

    def error(self, pose: Any, q: FloatArray) -> tuple[float, float]:
        """Return distance [m] and angle [rad] of a pose (inertial axes) from the place; q is (nq,)."""
        errors = self.pose_error(self.in_axes(pose, q))
        return float(errors.distance[0, 0]), float(errors.angle[0, 0])

    def at(self, q: FloatArray) -> Place:
        """Return the place in inertial axes, in a configuration (nq,)."""
        if not self.moves_with_base:
            return self
        base = pin.XYZQUATToSE3(q[:7])
        return replace(self.transformed(base.translation, base.rotation), on=INERTIAL)

    def transformed(self, shift: FloatArray, turn: FloatArray) -> Place:
        """Return the place with its pose transformed by x -> turn x + shift, with turn (3, 3) and shift (3,).

        Velocities are unchanged.
        """
        return replace(self.moved(shift, turn), position=shift + turn @ self.position)

    def moved(self, shift: FloatArray, turn: FloatArray) -> Place:
        """Return the place with its position displaced by `shift` (3,) and its attitude rotated by `turn`.

        `turn` is a rotation (3, 3). Both arrays may have K as their last axis. Velocities are unchanged.
        """
        rotation = None if self.rotation is None else np.einsum("xy...,yz...->xz...", turn, self.rotation)
        return replace(self, position=(self.position.T + shift.T).T, rotation=rotation)

    def aim(self, sms: SpaceManipulator, q: FloatArray) -> Place:
        """Return the place for a step from the configuration q (nq,), see `plain`.

        With a free axis, the attitude is the admissible attitude nearest to the end effector's attitude in q.
        """
        here = self.at(q)
        if here.free_axis is None:
            return here
        pose = sms.at(q).end_effector_pose
        turn = here.pose_error(frame_at(pose)).vector[:, 0, 0]
        return replace(here, rotation=pin.exp3(turn) @ pose.rotation, free_axis=None)

    def base_attitude(self, relative: FloatArray) -> FloatArray:
        """Return the base attitude (3, 3, ...) with which a frame has the desired attitude, inertial axes.

        `relative` (3, 3, ...) is the attitude of the frame relative to the base.
        """
        assert self.rotation is not None
        return np.asarray(np.einsum("xy,zy...->xz...", self.rotation, relative))

    def text(self) -> str:
        """Describe the place, for messages."""
        where = "[" + ", ".join(f"{x:.4g}" for x in self.position) + "] m"
        attitude = "" if self.rotation is None else " with an attitude"
        free = "" if self.free_axis is None else ", free to turn about an axis"
        return where + attitude + free + (", on the base" if self.moves_with_base else "")


def frame_at(pose: Any) -> FrameVariable:
    """Return a constant frame at a pose (pinocchio.SE3), for one motion at one instant."""
    return FrameVariable(pose.translation[:, None, None], pose.rotation[..., None, None], {}, {})


def stacked_places(places: list[Place]) -> Place:
    """Stack places at different times, all positions or all poses; the stack has no velocities."""
    turns = [place.rotation for place in places if place.rotation is not None]
    return replace(
        places[0],
        position=np.stack([place.position for place in places], axis=-1),
        rotation=np.stack(turns, axis=-1) if turns else None,
        velocity=None,
        angular_velocity=None,
    )


def deadzone(x: Variable, allowed: float, firm: bool = False) -> Variable:
    """Return vectors shortened by `allowed`; vectors shorter than `allowed` become zero.

    With `firm` the slopes are those of the full vectors. The gradient of the squared result is the same, but
    a Gauss-Newton step then fully penalises changes perpendicular to a vector, and changes of vectors shorter
    than `allowed`. Without `firm` such changes cost little or nothing in a step, and most long steps fail.
    """
    length = np.maximum(np.sqrt(dot(x.value, x.value)), _TINY)
    share, unit = np.maximum(1.0 - allowed / length, 0.0), x.value / length
    if firm:
        return Variable(share * x.value, lambda: x.slopes, x.where)
    if not share.any():
        return Variable(np.zeros_like(x.value), {}, x.where)

    def slopes() -> dict[str, FloatArray]:
        # The derivative is 1 along the vector, and `share` perpendicular to the vector.
        matrix = (np.where(share > 0.0, 1.0, 0.0) - share) * unit[:, None] * unit
        diagonal(matrix)[...] += share
        return {name: np.einsum("xy...,yz...->xz...", matrix, slope) for name, slope in x.slopes.items()}

    return Variable(share * x.value, slopes, x.where)


REACH = 0.02  # [m] the paper's r_th
ORIENTATION_REACH = 0.02  # [rad] about 1 deg: r_th divided by an arm length of 1 m; not from the paper
TOLERANCE = 1e-3  # [m, rad, m/s, rad/s] at the deadline, a twentieth of r_th; not from the paper
_REACHES = ("tolerance", "reach", "orientation_reach")
_PLACES = "a position (3,) [m], a pinocchio.SE3 or a homogeneous matrix (4, 4)"
GOALS = f"{_PLACES}, a function of time [s] that returns one of these, or a goal such as opt.Pose"


class Goal(ABC):
    """The desired pose of the end effector at the deadline.

    The pose error should be within `tolerance` at the deadline (`Trajectory.within_tolerance`), and must be
    within `reach` and `orientation_reach` in the last tenth of the time (`Trajectory.reached`).

    Attributes
    ----------
    tolerance : float
        Tolerance at the deadline for the position [m], and for attitude and velocities if they are
        constrained [rad, m/s, rad/s].
    reach : float
        Tolerance of the position in the last tenth of the time, the paper's r_th [m].
    orientation_reach : float
        Tolerance of the attitude in the last tenth of the time [rad].
    moves : bool
        True if the place depends on time.
    exact : bool
        True if `Trajectory.reached` requires that the errors of pose and velocities at the deadline are
        within `tolerance`.
    coupled : bool
        True if the paper's cost is a term by default. This cost favours velocities at an angle to the
        direction of the goal, so it does not suit goals that are approached along a line.
    at_rest_with : Client, capture.ClientEstimate or None
        The body with which the robot should be at rest after the capture. It determines the default momentum
        of a problem. A plan with another momentum has a note.
    coast : float or None
        The time after the deadline for which the joints keep their rates before they brake [s]. The plan
        leaves enough distance to the position limits for this motion. None: no distance is left.
    """

    tolerance: float = TOLERANCE
    reach: float = REACH
    orientation_reach: float = ORIENTATION_REACH
    moves: ClassVar[bool] = False
    exact: ClassVar[bool] = False
    coupled: ClassVar[bool] = True
    at_rest_with: ClassVar[FreeBody | None] = None
    coast: ClassVar[float | None] = None

    @abstractmethod
    def place(self, t: float) -> Place:
        """Return the place at a time [s], with its velocities if they are constrained."""

    def places(self, times: FloatArray) -> Place:
        """Return the places at times (K,) [s] as a stack without velocities; K = 1 if the goal is fixed."""
        if not self.moves:
            return self._standing
        return stacked_places([self.place(t) for t in times.tolist()])

    @cached_property
    def _standing(self) -> Place:
        return stacked_places([self.place(0.0)])

    def for_motion(self, sms: SpaceManipulator, q0: FloatArray, duration: float) -> Goal:
        """Return the goal for a motion from q0 (nq,) that lasts `duration` [s]. Default: the goal itself."""
        return self

    def approach(self, duration: float) -> list[tuple[float, Place]]:
        """Return times [s] and places on the approach to the goal, for initial guesses of a search.

        The default is an empty list.
        """
        return []

    def limits(self, duration: float) -> tuple[Limit, ...]:
        """Return the limits that this goal adds to a problem of a duration [s]. Default: none."""
        return ()


class Fixed(Goal):
    """A goal that is fixed in inertial axes or on the base (`on`)."""

    on: str
    _place: Place

    def _stay(
        self, position: Any, turn: Any, velocity: Any, angular_velocity: Any = None, axis: Any = None
    ) -> None:
        """Check the common fields of fixed goals, and store the place."""
        check_reaches(self)
        axis = None if axis is None else checks.direction("goal.free_axis", axis)
        if checks.one_of("goal.on", self.on, (INERTIAL, BASE)) == BASE and velocity is not None:
            name = "goal.velocity" if angular_velocity is None else "goal.twist"
            raise InvalidValue(name, velocity, "must be left out of a goal on the base")
        object.__setattr__(self, "_place", Place(position, turn, velocity, angular_velocity, axis, self.on))

    def place(self, t: float) -> Place:
        """Return the place, which is the same at all times."""
        return self._place


@dataclass(frozen=True, eq=False)
class Position(Fixed):
    """A position of the end effector, with any attitude; for `tolerance` and `reach` see `Goal`.

    Attributes
    ----------
    position : array_like, shape (3,)
        The desired position [m].
    velocity : array_like, shape (3,), optional
        The desired velocity at the deadline, inertial axes [m/s]. Default: the joints come to rest.
    on : {"inertial", "base"}
        The axes of the position. With "base" they are those of the base link's frame, with which the goal
        moves.
    """

    position: Any
    velocity: Any = None
    tolerance: float = TOLERANCE
    reach: float = REACH
    on: str = "inertial"

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", frozen(vector("position", self.position, 3, "m")))
        if self.velocity is not None:
            object.__setattr__(self, "velocity", frozen(vector("goal.velocity", self.velocity, 3, "m/s")))
        self._stay(self.position, None, self.velocity)


@dataclass(frozen=True, eq=False)
class Pose(Fixed):
    """A pose of the end-effector frame; for tolerance and reaches see `Goal`, for `on` see `Position`.

    Attributes
    ----------
    pose : pinocchio.SE3 or array_like, shape (4, 4)
        The desired pose.
    twist : array_like, shape (6,), optional
        The desired velocity and angular velocity at the deadline, inertial axes [m/s; rad/s]. Default: the
        joints come to rest.
    free_axis : array_like, shape (3,), optional
        The axis, in the axes of the end-effector frame, about which rotation is free, for example the
        axis of a rotationally symmetric tool. Its length is ignored. Default: none.
    """

    pose: Any
    twist: Any = None
    tolerance: Annotated[Positive, Unit("m, rad, m/s, rad/s")] = TOLERANCE
    reach: Annotated[Positive, Unit("m")] = REACH
    orientation_reach: Annotated[Positive, Angle("rad")] = ORIENTATION_REACH
    free_axis: Any = None
    on: str = "inertial"

    def __post_init__(self) -> None:
        object.__setattr__(self, "pose", checks.from_homogeneous("pose", self.pose))
        if not isinstance(self.pose, pin.SE3):
            remedy = "must be a pinocchio.SE3, or a homogeneous matrix (4, 4)"
            raise InvalidValue("pose", self.pose, remedy)
        position = frozen(vector("pose.translation", self.pose.translation, 3, "m"))
        turn = frozen(checks.rotation("pose.rotation", self.pose.rotation))
        velocity = angular_velocity = None
        if self.twist is not None:
            twist = frozen(vector("goal.twist", self.twist, 6))
            velocity, angular_velocity = twist[:3], twist[3:]
        self._stay(position, turn, velocity, angular_velocity, self.free_axis)


@dataclass(frozen=True, eq=False)
class Moving(Goal):
    """A moving goal that the end effector meets at the deadline with the goal's velocity; see `Goal`.

    Attributes
    ----------
    path : callable
        A smooth function of time [s] that returns a position (3,) [m], a pinocchio.SE3 or a homogeneous
        matrix (4, 4), inertial axes. The velocity is computed from its values 1 ms before and after a time.
    """

    path: Callable[[float], Any]
    tolerance: float = TOLERANCE
    reach: float = REACH
    orientation_reach: float = ORIENTATION_REACH

    moves: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_reaches(self)
        if not callable(self.path):
            raise InvalidValue("path", self.path, "must be a function of time [s]")
        self.place(0.0)

    def place(self, t: float) -> Place:
        """Return the place at a time [s], with its velocities."""
        h = 1e-3  # [s] step of the central differences
        behind, here, ahead = (as_goal(self.path(time)).place(time) for time in (t - h, t, t + h))
        return here.moving(behind, ahead, 2.0 * h)

    def places(self, times: FloatArray) -> Place:
        """Return the places at times (K,) [s]."""
        poses = [checks.from_homogeneous("path", self.path(t)) for t in times.tolist()]
        turned = isinstance(poses[0], pin.SE3)
        position = np.stack([x.translation if turned else np.asarray(x, dtype=float) for x in poses], axis=-1)
        if not np.isfinite(position).all():
            raise InvalidValue("path", position, "must return finite positions [m]")
        return Place(position, np.stack([x.rotation for x in poses], axis=-1) if turned else None)


@dataclass(frozen=True, eq=False)
class Changed(Goal):
    """A goal that solvers derive from another goal, `goal`.

    The place at time t is the place of `goal` at t + `time_offset` [s], mapped by the function `change`,
    which must also accept a stack of places. Tolerance and reaches default to those of `goal`.
    """

    goal: Goal
    change: Callable[[Place], Place] | None = None
    time_offset: float = 0.0
    tolerance: float = None  # type: ignore[assignment]  # default: that of `goal`
    reach: float = None  # type: ignore[assignment]
    orientation_reach: float = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        of_class = ("moves", "exact", "coupled", "at_rest_with", "coast")
        for name in (*of_class, *(name for name in _REACHES if getattr(self, name) is None)):
            object.__setattr__(self, name, getattr(self.goal, name))

    def place(self, t: float) -> Place:
        """Return the changed place of `goal` at t + `time_offset` [s]."""
        return self._changed(self.goal.place(t + self.time_offset))

    def places(self, times: FloatArray) -> Place:
        """Return the changed places of `goal` at times (K,) + `time_offset` [s]."""
        return self._changed(self.goal.places(times + self.time_offset))

    def approach(self, duration: float) -> list[tuple[float, Place]]:
        """Return the changed approach of `goal`, without its part before `time_offset`."""
        ahead = [
            (t - self.time_offset, place) for t, place in self.goal.approach(duration + self.time_offset)
        ]
        return [(t, self._changed(place)) for t, place in ahead if t > 0.0 or not self.time_offset]

    def _changed(self, place: Place) -> Place:
        return place if self.change is None else self.change(place)


def as_goal(value: Any, name: str = "goal", kinds: str = GOALS) -> Goal:
    """Return the goal for a value: a position (3,), a pose, a function of time, or a goal.

    Error messages contain `name`, and the admissible types as described by `kinds`.
    """
    if isinstance(value, Goal):
        return value
    if callable(value):
        _still(value(0.0), f"{name}(0)", _PLACES)
        return Moving(value)
    return _still(value, name, kinds)


def _still(value: Any, name: str, kinds: str) -> Goal:
    """Return the fixed goal for a position (3,) or a pose."""
    value = checks.from_homogeneous(name, value)
    if isinstance(value, pin.SE3):
        vector(f"{name}.translation", value.translation, 3, "m")
        checks.rotation(f"{name}.rotation", value.rotation)
        return Pose(value)
    try:
        fits = np.shape(value) == (3,)
    except ValueError:  # rows of different lengths
        fits = False
    if isinstance(value, FreeBody):
        remedy = "is a body and not a pose; use opt.Meet(client, grasp) with the grasp's pose on the body"
        raise InvalidValue(name, value, remedy)
    if not fits:
        raise InvalidValue(name, value, f"must be {kinds}")
    return Position(vector(name, value, 3, "m"))


def check_reaches(goal: Goal) -> None:
    """Raise `InvalidValue` if the tolerance or a reach of a goal is not a number above zero."""
    for name in _REACHES:
        checks.positive(f"goal.{name}", getattr(goal, name))
