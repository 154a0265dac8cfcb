"""Goals of the end effector: fixed goals, moving goals, and modified goals; and their places.

A place is the desired pose of a frame of the robot at one time. `Place` has all that depends on its free
axes: the error of a position is a displacement, that of a pose a displacement and a rotation.
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

_TINY = 1e-12  # below this length a vector has no direction
_OPPOSITE = 1e-8  # [rad] an axis within this angle of the opposite direction has no unique rotation


class PoseError(NamedTuple):
    """The pose error of frames: displacement (3, S, K) [m] and rotation (3, S, K) [rad] in the place's axes.

    The rotation is a rotation vector to the nearest admissible attitude. None: any attitude is admissible.
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

    def words(self) -> str:
        """Return a text of the largest distance, and the largest angle if the attitude is constrained."""
        angle = "" if self.rotation is None else f", turned by {np.degrees(self.angle.max()):.2f} deg,"
        return f"{1e3 * self.distance.max():.1f} mm{angle}"


@dataclass(frozen=True, eq=False)
class Place:
    """The desired pose of a frame of the robot at one time, or at each of K times (arrays then end in K)."""

    position: FloatArray  # (3,) [m]
    rotation: FloatArray | None = None  # (3, 3); None: any attitude
    velocity: FloatArray | None = None  # (3,) [m/s]; None: any
    angular_velocity: FloatArray | None = None  # (3,) [rad/s]; None: any
    free_axis: FloatArray | None = None  # (3,) unit vector in the frame's axes; rotation about it is free
    on: str = INERTIAL  # the axes of the place, or BASE: those of the base link, with which the place moves

    @property
    def moves_with_base(self) -> bool:
        """True if the place is fixed to the robot's base."""
        return self.on == BASE

    @property
    def plain(self) -> bool:
        """True if single steps can aim at the place, which then has inertial axes and no free axis."""
        return self.on == INERTIAL and self.free_axis is None

    @property
    def rests(self) -> bool:
        """True if the place has no desired velocity."""
        return self.velocity is None and self.angular_velocity is None

    @property
    def twist(self) -> FloatArray:
        """The desired velocity and angular velocity (6,); zero where any is admissible."""
        parts = (self.velocity, self.angular_velocity)
        return np.concatenate([np.zeros(3) if part is None else part for part in parts])

    @property
    def attitude(self) -> FloatArray:
        """The desired attitude (3, 3); NaN if any is admissible."""
        return np.full((3, 3), np.nan) if self.rotation is None else self.rotation

    def moving(self, behind: Place, ahead: Place, time: float) -> Place:
        """Return the place with the velocities of a motion between two places in a time [s]."""
        spin = None
        if behind.rotation is not None and ahead.rotation is not None:
            spin = pin.log3(ahead.rotation @ behind.rotation.T) / time
        return replace(self, velocity=(ahead.position - behind.position) / time, angular_velocity=spin)

    def pose_error(self, frame: FrameVariable) -> PoseError:
        """Return the pose error of frames (3, S, K) in the place's axes (`Variables.frame(name, on)`)."""
        displacement: Variable = np.subtract(self.position.reshape(3, 1, -1), frame)  # type: ignore[assignment]
        if self.rotation is None:
            return PoseError(displacement)
        if self.free_axis is None:
            return PoseError(displacement, -frame.rotation_vector_from(self.rotation))
        wanted = np.einsum("xy...,y->x...", self.rotation, self.free_axis).reshape(3, 1, -1)
        now = frame.axis(self.free_axis)
        across, cosine = now.cross(wanted), now.dot(wanted)
        # A rotation by pi may be about any perpendicular axis.
        opposite = (across.norm().value < _OPPOSITE) & (cosine.value < 0.0)
        aside = np.cross(wanted, np.eye(3)[:, np.abs(wanted).argmin(axis=0)], axis=0)
        across = across * np.where(opposite, 0.0, 1.0) + np.where(opposite, aside, 0.0)
        sine = across.norm(_TINY)
        angle = np.arctan2(sine * np.where(opposite, 0.0, 1.0), cosine)
        return PoseError(displacement, across * (angle / sine))

    def counting(self, columns: FloatArray) -> FloatArray:
        """Return angular velocities (3, n, K) without the part about the free axis; zero without attitude."""
        if self.rotation is None:
            return columns[:0]
        if self.free_axis is None:
            return columns
        axis = self.rotation @ self.free_axis
        about: FloatArray = np.einsum("x,y,y...->x...", axis, axis, columns)
        return columns - about

    def seen(self, pose: Any, q: FloatArray) -> FrameVariable:
        """Return a frame's pose (pinocchio.SE3, inertial axes) in the place's axes, at a q (nq,)."""
        return frame_at(pin.XYZQUATToSE3(q[:7]).actInv(pose) if self.moves_with_base else pose)

    def error(self, pose: Any, q: FloatArray) -> tuple[float, float]:
        """Return the distance [m] and the angle [rad] of a pose to the place."""
        errors = self.pose_error(self.seen(pose, q))
        return float(errors.distance[0, 0]), float(errors.angle[0, 0])

    def at(self, q: FloatArray) -> Place:
        """Return the place in inertial axes, in a configuration (nq,)."""
        if not self.moves_with_base:
            return self
        base = pin.XYZQUATToSE3(q[:7])
        return replace(self.transformed(base.translation, base.rotation), on=INERTIAL)

    def transformed(self, shift: FloatArray, turn: FloatArray) -> Place:
        """Return the place transformed by a rotation (3, 3) and a displacement (3,): x -> turn x + shift."""
        return replace(self.moved(shift, turn), position=shift + turn @ self.position)

    def moved(self, shift: FloatArray, turn: FloatArray) -> Place:
        """Return the place displaced by `shift` and rotated by `turn`: (3,), (3, 3), or K of them."""
        rotation = None if self.rotation is None else np.einsum("xy...,yz...->xz...", turn, self.rotation)
        return replace(self, position=(self.position.T + shift.T).T, rotation=rotation)

    def aim(self, sms: SpaceManipulator, q: FloatArray) -> Place:
        """Return a plain place for a step: the present place, with the arm's rotation about a free axis."""
        here = self.at(q)
        if here.free_axis is None:
            return here
        pose = sms.at(q).end_effector_pose
        turn = here.pose_error(frame_at(pose)).vector[:, 0, 0]
        return replace(here, rotation=pin.exp3(turn) @ pose.rotation, free_axis=None)

    def base_attitude(self, seen: FloatArray) -> FloatArray:
        """Return the base's attitude (3, 3, ...) with the frame, `seen` (3, 3, ...) from it, at the place."""
        assert self.rotation is not None
        return np.asarray(np.einsum("xy,zy...->xz...", self.rotation, seen))

    def words(self) -> str:
        """Return a description, for messages."""
        where = "[" + ", ".join(f"{x:.4g}" for x in self.position) + "] m"
        attitude = "" if self.rotation is None else " in an attitude"
        free = "" if self.free_axis is None else ", free to turn about an axis"
        return where + attitude + free + (", on the base" if self.moves_with_base else "")


def frame_at(pose: Any) -> FrameVariable:
    """Return a constant frame at a pose (pinocchio.SE3), for one motion at one instant."""
    return FrameVariable(pose.translation[:, None, None], pose.rotation[..., None, None], {}, {})


def stacked_places(places: list[Place]) -> Place:
    """Stack places of one kind, without velocities."""
    turns = [place.rotation for place in places if place.rotation is not None]
    return replace(
        places[0],
        position=np.stack([place.position for place in places], axis=-1),
        rotation=np.stack(turns, axis=-1) if turns else None,
        velocity=None,
        angular_velocity=None,
    )


def deadzone(x: Variable, allowed: float, firm: bool = False) -> Variable:
    """Return vectors shortened by the tolerance, zero within it.

    With `firm` the slopes are those of the full vectors. The gradient of the square is the same, but a step
    with these slopes also penalises changes of vectors across themselves and within the tolerance. With its
    own slopes such changes are free, and most long steps fail by them.
    """
    length = np.maximum(np.sqrt(dot(x.value, x.value)), 1e-12)  # a shorter one has no direction
    share, unit = np.maximum(1.0 - allowed / length, 0.0), x.value / length
    if firm:
        return Variable(share * x.value, lambda: x.slopes, x.where)
    if not share.any():
        return Variable(np.zeros_like(x.value), {}, x.where)

    def slopes() -> dict[str, FloatArray]:
        # Along the vector the slope is 1, across it is the remaining share of the length.
        matrix = (np.where(share > 0.0, 1.0, 0.0) - share) * unit[:, None] * unit
        diagonal(matrix)[...] += share
        return {name: np.einsum("xy...,yz...->xz...", matrix, slope) for name, slope in x.slopes.items()}

    return Variable(share * x.value, slopes, x.where)


REACH = 0.02  # [m] the paper's r_th
ORIENTATION_REACH = 0.02  # [rad] about a degree, r_th at an arm of one metre; not from the paper
TOLERANCE = 1e-3  # [m, rad, m/s, rad/s] at the deadline, a twentieth of r_th; not from the paper
_REACHES = ("tolerance", "reach", "orientation_reach")
_PLACES = "a position (3,) [m], a pinocchio.SE3 or a homogeneous matrix (4, 4)"
GOALS = f"{_PLACES}, a function of time [s] that gives one, or a goal such as opt.Pose"


class Goal(ABC):
    """The desired pose of the end effector, within `tolerance` at the deadline, near it in the last tenth.

    Attributes
    ----------
    tolerance : float
        Tolerance at the deadline, of the position [m], and of attitude and velocities if they are constrained
        [rad, m/s, rad/s].
    reach : float
        Tolerance of the position in the last tenth of the time, the paper's r_th [m].
    orientation_reach : float
        Tolerance of the attitude in the last tenth of the time [rad].
    moves : bool
        True if the place depends on the time.
    exact : bool
        True if a plan reaches the goal only within the tolerance at the deadline, velocities included.
    coupled : bool
        True if the paper's cost is a term by default. It favours motions at an angle to the direct one, so it
        does not suit goals that are approached along a line.
    at_rest_with : Client, capture.ClientEstimate or None
        A body with which the robot should be at rest after the capture. A problem without a momentum has the
        one for that; a plan with another momentum has a note.
    coast : float or None
        Time after the deadline for which the joints keep their rates before they brake [s]. The plan leaves
        the distance for both before the position limits. None: no distance is left.
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
        """Return the place at a time; its velocities matter at the deadline only."""

    def places(self, times: FloatArray) -> Place:
        """Return the places at times (K,) [s] as a stack without velocities; one place if it is fixed."""
        if not self.moves:
            return self._standing
        return stacked_places([self.place(t) for t in times.tolist()])

    @cached_property
    def _standing(self) -> Place:
        return stacked_places([self.place(0.0)])

    def for_motion(self, sms: SpaceManipulator, q0: FloatArray, duration: float) -> Goal:
        """Return the goal for a motion from q0 (nq,) that lasts `duration` [s]. Default: itself."""
        return self

    def approach(self, duration: float) -> list[tuple[float, Place]]:
        """Return times [s] and places on the approach before a deadline, for initial guesses of a search."""
        return []

    def limits(self, duration: float) -> tuple[Limit, ...]:
        """Return the limits of the goal for a motion to a deadline [s]; a problem adds them."""
        return ()


class Fixed(Goal):
    """A fixed goal in its axes `on`."""

    on: str
    _place: Place

    def _stay(self, position: Any, turn: Any, velocity: Any, spin: Any = None, axis: Any = None) -> None:
        """Check the common fields of fixed goals, and store the place."""
        check_reaches(self)
        axis = None if axis is None else checks.direction("goal.free_axis", axis)
        if checks.one_of("goal.on", self.on, (INERTIAL, BASE)) == BASE and velocity is not None:
            raise InvalidValue("goal.velocity", velocity, "must be left out of a goal on the base")
        object.__setattr__(self, "_place", Place(position, turn, velocity, spin, axis, self.on))

    def place(self, t: float) -> Place:
        """Return the place, which is the same at all times."""
        return self._place


@dataclass(frozen=True, eq=False)
class Position(Fixed):
    """A position of the end effector, in any attitude; for `tolerance` and `reach` see `Goal`.

    Attributes
    ----------
    position : array_like, shape (3,)
        [m]
    velocity : array_like, shape (3,), optional
        Desired velocity at the deadline, inertial axes [m/s]. Default: the arm comes to rest.
    on : {"inertial", "base"}
        The axes of the place: inertial axes, or those of the base link's frame, with which the goal then
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
    twist : array_like, shape (6,), optional
        Desired velocity and angular velocity at the deadline, inertial axes [m/s; rad/s]. Default: the arm
        comes to rest.
    free_axis : array_like, shape (3,), optional
        Axis of the end-effector frame, in its own axes, about which its rotation is free, as for a
        rotationally symmetric tool. Its length is ignored. Default: none.
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
        velocity = spin = None
        if self.twist is not None:
            twist = frozen(vector("goal.twist", self.twist, 6))
            velocity, spin = twist[:3], twist[3:]
        self._stay(position, turn, velocity, spin, self.free_axis)


@dataclass(frozen=True, eq=False)
class Moving(Goal):
    """A moving goal that the end effector meets at the deadline, with its velocity; see `Goal`.

    Attributes
    ----------
    path : callable
        A smooth function from a time [s] to a position (3,) [m], a pinocchio.SE3 or a homogeneous matrix (4,
        4), inertial axes.
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
        """Return the path's place, with its velocities."""
        h = 1e-3  # [s] step of differences, with a relative error of the velocity of 1e-7
        behind, here, ahead = (as_goal(self.path(time)).place(time) for time in (t - h, t, t + h))
        return here.moving(behind, ahead, 2.0 * h)

    def places(self, times: FloatArray) -> Place:
        """Return the path's places at times (K,) [s]."""
        poses = [checks.from_homogeneous("path", self.path(t)) for t in times.tolist()]
        turned = isinstance(poses[0], pin.SE3)
        position = np.stack([x.translation if turned else np.asarray(x, dtype=float) for x in poses], axis=-1)
        if not np.isfinite(position).all():
            raise InvalidValue("path", position, "must return finite positions [m]")
        return Place(position, np.stack([x.rotation for x in poses], axis=-1) if turned else None)


@dataclass(frozen=True, eq=False)
class Changed(Goal):
    """A goal that solvers derive from another goal, by transforming it or shifting it by `time_offset` [s].

    `change` maps a place of the other goal, or a stack of places, to the place of this goal. Fields that are
    not given have the values of the other goal.
    """

    goal: Goal
    change: Callable[[Place], Place] | None = None
    time_offset: float = 0.0
    tolerance: float = None  # type: ignore[assignment]  # the other's by default
    reach: float = None  # type: ignore[assignment]
    orientation_reach: float = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        of_class = ("moves", "exact", "coupled", "at_rest_with", "coast")
        for name in (*of_class, *(name for name in _REACHES if getattr(self, name) is None)):
            object.__setattr__(self, name, getattr(self.goal, name))

    def place(self, t: float) -> Place:
        """Return the transformed place of the other goal at t + `time_offset` [s]."""
        return self._changed(self.goal.place(t + self.time_offset))

    def places(self, times: FloatArray) -> Place:
        """Return the transformed places of the other goal at `times` + `time_offset` [s]."""
        return self._changed(self.goal.places(times + self.time_offset))

    def approach(self, duration: float) -> list[tuple[float, Place]]:
        """Return the remaining approach of the other goal."""
        ahead = [
            (t - self.time_offset, place) for t, place in self.goal.approach(duration + self.time_offset)
        ]
        return [(t, self._changed(place)) for t, place in ahead if t > 0.0 or not self.time_offset]

    def _changed(self, place: Place) -> Place:
        return place if self.change is None else self.change(place)


def as_goal(value: Any, name: str = "goal", kinds: str = GOALS) -> Goal:
    """Return the goal of a plain value: a position (3,), a pose, or a function of time.

    Errors have the value's `name`, and `kinds` as the text of its admissible types.
    """
    if isinstance(value, Goal):
        return value
    if callable(value):
        _still(value(0.0), f"{name}(0)", _PLACES)
        return Moving(value)
    return _still(value, name, kinds)


def _still(value: Any, name: str, kinds: str) -> Goal:
    """Return the goal at a plain place."""
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
        remedy = "is a body and not a place on it; give opt.Meet(client, grasp), the grasp frame in its axes"
        raise InvalidValue(name, value, remedy)
    if not fits:
        raise InvalidValue(name, value, f"must be {kinds}")
    return Position(vector(name, value, 3, "m"))


def check_reaches(goal: Goal) -> None:
    """Raise `InvalidValue` unless the tolerance and the reaches of a goal are above zero."""
    for name in _REACHES:
        checks.positive(f"goal.{name}", getattr(goal, name))
