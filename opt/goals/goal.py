"""What every goal has; goals that stand still, a path, and another goal changed."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ffsms_pin import checks
from ffsms_pin.checks import FloatArray, frozen, vector
from ffsms_pin.client import Client, ClientEstimate
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.goals.place import Place, stacked_places
from ffsms_pin.opt.motion.frame import BASE, INERTIAL

if TYPE_CHECKING:
    from ffsms_pin.opt.limits.limit import Limit

REACH = 0.02  # [m] the paper's r_th
ORIENTATION_REACH = 0.02  # [rad] ours: about a degree, as far as r_th turns an arm of one metre
TOLERANCE = 1e-3  # [m, rad, m/s, rad/s] ours, at the deadline: a twentieth of r_th
_REACHES = ("tolerance", "reach", "orientation_reach")
_PLACES = "a position (3,) [m], a pinocchio.SE3 or a homogeneous matrix (4, 4)"
GOALS = f"{_PLACES}, a function of time [s] that gives one, or a goal such as opt.Pose"


class Goal(ABC):
    """Where the end effector should be: at the deadline within `tolerance`, near it in the last tenth.

    Attributes
    ----------
    tolerance : float
        At the deadline: of the position [m], and of the attitude and the velocities where they are asked for
        [rad, m/s, rad/s].
    reach, orientation_reach : float
        In the last tenth of the time: of the position, the paper's r_th [m], and of the attitude [rad].
    moves : bool
        Whether the place depends on the time.
    exact : bool
        Whether a plan has reached the goal only with an end within the tolerance, velocities included.
    coupled : bool
        Whether the paper's cost is a term by default: it asks for ways across the one to the goal, so not of
        a goal that is approached along a line.
    at_rest_with : Client, ClientEstimate or None
        A body with which the robot should be at rest after it has taken hold of it: a problem without a
        momentum takes the one for that, and a plan for another one says so.
    coast : float or None
        Time after the deadline for which the joints keep their rates before they brake [s]: they have room
        for that and for braking before their stops. None: nothing follows.
    """

    tolerance: float = TOLERANCE
    reach: float = REACH
    orientation_reach: float = ORIENTATION_REACH
    moves: ClassVar[bool] = False
    exact: ClassVar[bool] = False
    coupled: ClassVar[bool] = True
    at_rest_with: ClassVar[Client | ClientEstimate | None] = None
    coast: ClassVar[float | None] = None

    @abstractmethod
    def place(self, t: float) -> Place:
        """Where the end effector should be at a time, the velocities counting at the deadline only."""

    def places(self, times: FloatArray) -> Place:
        """Places without velocities at times (K,) [s], stacked: K of them, or one where the goal stays."""
        if not self.moves:
            return self._standing
        return stacked_places([self.place(t) for t in times.tolist()])

    @cached_property
    def _standing(self) -> Place:
        return stacked_places([self.place(0.0)])

    def approach(self, duration: float) -> list[tuple[float, Place]]:
        """Times [s] and places to come by before a deadline, in order, in motions to start a search from."""
        return []

    def limits(self, duration: float) -> tuple[Limit, ...]:
        """Limits that belong to the goal, for a motion to a deadline [s]; a problem takes them up."""
        return ()


class Fixed(Goal):
    """A goal that stays where it is, in its own axes `on`."""

    on: str
    _place: Place

    def _stay(self, position: Any, turn: Any, velocity: Any, spin: Any = None, axis: Any = None) -> None:
        """Check what kinds of places have in common, and keep this one."""
        check_reaches(self)
        axis = None if axis is None else checks.direction("goal.free_axis", axis)
        if checks.one_of("goal.on", self.on, (INERTIAL, BASE)) == BASE and velocity is not None:
            raise InvalidValue("goal.velocity", velocity, "must be left out of a goal on the base")
        object.__setattr__(self, "_place", Place(position, turn, velocity, spin, axis, self.on))

    def place(self, t: float) -> Place:
        """The same at all times."""
        return self._place


@dataclass(frozen=True, eq=False)
class Position(Fixed):
    """The end effector at a place, in any attitude; for `tolerance` and `reach` see `Goal`.

    Attributes
    ----------
    position : array_like, shape (3,)
        [m]
    velocity : array_like, shape (3,), optional
        At the deadline, inertial axes [m/s]; default: the arm comes to rest.
    on : {"inertial", "base"}
        The axes of the place: inertial ones, or those of the base link's frame, with which the goal then
        moves and turns.
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
    """The end-effector frame at a pose; for tolerance and reaches see `Goal`, for `on` see `Position`.

    Attributes
    ----------
    pose : pinocchio.SE3 or array_like, shape (4, 4)
    twist : array_like, shape (6,), optional
        Velocity and angular velocity at the deadline, inertial axes [m/s; rad/s]; default: the arm comes to
        rest.
    free_axis : array_like, shape (3,), optional
        Axis of the end-effector frame, in its own axes, about which it may be turned by any angle: a tool
        that is round about it. Its length does not matter. Default: none.
    """

    pose: Any
    twist: Any = None
    tolerance: float = TOLERANCE
    reach: float = REACH
    orientation_reach: float = ORIENTATION_REACH
    free_axis: Any = None
    on: str = "inertial"

    def __post_init__(self) -> None:
        object.__setattr__(self, "pose", checks.from_homogeneous("pose", self.pose))
        if not (hasattr(self.pose, "translation") and hasattr(self.pose, "rotation")):
            words = "must be a pinocchio.SE3, or a homogeneous matrix (4, 4)"
            raise InvalidValue("pose", self.pose, words)
        position = frozen(vector("pose.translation", self.pose.translation, 3, "m"))
        turn = frozen(checks.rotation("pose.rotation", self.pose.rotation))
        velocity = spin = None
        if self.twist is not None:
            twist = frozen(vector("goal.twist", self.twist, 6))
            velocity, spin = twist[:3], twist[3:]
        self._stay(position, turn, velocity, spin, self.free_axis)


@dataclass(frozen=True, eq=False)
class Moving(Goal):
    """A place that moves: the end effector meets it at the deadline, with its velocity; see `Goal`.

    Attributes
    ----------
    path : callable
        From a time [s] to a position (3,) [m], a pinocchio.SE3 or a homogeneous matrix (4, 4), inertial axes;
        smooth.
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
        """Where the path is, and how fast."""
        h = 1e-3  # [s] positions then carry the velocity to 1e-7 of theirs
        behind, here, ahead = (as_goal(self.path(time)).place(time) for time in (t - h, t, t + h))
        return here.moving(behind, ahead, 2.0 * h)

    def places(self, times: FloatArray) -> Place:
        """Where the path is at times (K,) [s]."""
        found = [checks.from_homogeneous("path", self.path(t)) for t in times.tolist()]
        turned = hasattr(found[0], "translation")
        position = np.stack([x.translation if turned else np.asarray(x, dtype=float) for x in found], axis=-1)
        if not np.isfinite(position).all():
            raise InvalidValue("path", position, "must give finite positions [m]")
        return Place(position, np.stack([x.rotation for x in found], axis=-1) if turned else None)


@dataclass(frozen=True, eq=False)
class Changed(Goal):
    """Another goal with its places changed, or seen from `later` seconds on: what solvers aim at instead.

    `change` takes a place of that goal, or a stack of them, to this one's. All else is that goal's, where
    nothing else is given.
    """

    goal: Goal
    change: Callable[[Place], Place] | None = None
    later: float = 0.0
    tolerance: float = None  # type: ignore[assignment]  # the other's are put in their place
    reach: float = None  # type: ignore[assignment]
    orientation_reach: float = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        of_class = ("moves", "exact", "coupled", "at_rest_with", "coast")
        for name in (*of_class, *(one for one in _REACHES if getattr(self, one) is None)):
            object.__setattr__(self, name, getattr(self.goal, name))

    def place(self, t: float) -> Place:
        """The other's place, `later` seconds later, changed."""
        return self._changed(self.goal.place(t + self.later))

    def places(self, times: FloatArray) -> Place:
        """Likewise."""
        return self._changed(self.goal.places(times + self.later))

    def approach(self, duration: float) -> list[tuple[float, Place]]:
        """The other's, as far as it still lies ahead."""
        ahead = [(t - self.later, place) for t, place in self.goal.approach(duration + self.later)]
        return [(t, self._changed(place)) for t, place in ahead if t > 0.0 or not self.later]

    def _changed(self, place: Place) -> Place:
        return place if self.change is None else self.change(place)


def as_goal(value: Any, name: str = "goal", kinds: str = GOALS) -> Goal:
    """Return the goal that a plain value means: a position (3,), a pose, or a function of time.

    Errors call the value by `name`, and say by `kinds` what it may be.
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
    if hasattr(value, "translation") and hasattr(value, "rotation"):
        vector(f"{name}.translation", value.translation, 3, "m")
        checks.rotation(f"{name}.rotation", value.rotation)
        return Pose(value)
    try:
        fits = np.shape(value) == (3,)
    except ValueError:  # rows of different lengths
        fits = False
    if isinstance(value, (Client, ClientEstimate)):
        words = "is a body and not a place on it; give opt.Meet(client, grasp), the grasp frame in its axes"
        raise InvalidValue(name, value, words)
    if not fits:
        raise InvalidValue(name, value, f"must be {kinds}")
    return Position(vector(name, value, 3, "m"))


def check_reaches(goal: Goal) -> None:
    """Raise `InvalidValue` unless the tolerance and the reaches of a goal are above zero."""
    for name in _REACHES:
        checks.positive(f"goal.{name}", getattr(goal, name))
