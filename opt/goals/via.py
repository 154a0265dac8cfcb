"""A waypoint: where the end effector passes on its way, at a time or at any time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray, at_least_zero, positive
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.goals.goal import ORIENTATION_REACH, resting_place
from ffsms_pin.opt.goals.missed import Missed
from ffsms_pin.opt.goals.near import Near
from ffsms_pin.opt.goals.place import Place
from ffsms_pin.opt.limits.limit import Limit, Rows, Violation
from ffsms_pin.opt.motion.motions import Motions
from ffsms_pin.opt.motion.residual import Indices, Residuals
from ffsms_pin.opt.motion.robot_frame import RobotFrame
from ffsms_pin.opt.step.state import StepState
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.batch.arm import ArmStack
from ffsms_pin.system.batch.stacks import apply, dot, exp3

if TYPE_CHECKING:
    from ffsms_pin.opt.trajectory import Trajectory

__all__ = ["Via"]

_REACH = 0.01  # [m] half of the paper's r_th
_NEAR = 0.5  # share of the reach: nearer than that there is nothing to gain
_BINDING = 0.9  # share of the reach beyond which the limit binds


class _Passing(NamedTuple):
    """Where each of S motions passes: the instant, how much later [s], and what is missed then (3, S)."""

    instant: Indices
    later: FloatArray
    missed: Missed


@dataclass(frozen=True, eq=False)
class Via(Limit):
    """The end effector passes a place, at a given time or at any time before the deadline.

    Several of them need a `name` each. Those without a time are passed in any order.

    Attributes
    ----------
    place : array_like, shape (3,), pinocchio.SE3, opt.Position or opt.Pose
        Inertial axes [m].
    time : float, optional
        From the start of the motion [s]. Default: any; single steps then ask for nothing, since they do not
        know whether the place was passed already.
    reach : float
        How near to the place it passes [m].
    orientation_reach : float
        How near to the attitude, where the place is a pose [rad].
    name : str
        Key of `Trajectory.binding`.
    reserve : float
        What whole motions keep in hand beyond their margin [m, rad].
    began : float
        When the motion began, counted as `time` is: for the rest of a motion [s].
    margin : float
        See `Limit`; set for each robot.

    Raises
    ------
    InvalidValue
        A place that moves or asks for a velocity, a time below zero, a reach that is not above zero.
    """

    place: Any
    time: float | None = None
    reach: float = _REACH
    orientation_reach: float = ORIENTATION_REACH
    name: str = "via"
    reserve: float = 0.0
    began: float = 0.0
    margin: float = 0.0
    of_paper = False
    _near: Near = None  # type: ignore[assignment]  # for_robot gives it

    def __post_init__(self) -> None:
        if not isinstance(self.place, Place):
            object.__setattr__(self, "place", resting_place("place", self.place))
        if self.place.moves_with_base:
            raise InvalidValue("place", self.place, "must be in inertial axes")
        if self.time is not None:
            at_least_zero("time", self.time, "s")
        positive("reach", self.reach, "m")
        positive("orientation_reach", self.orientation_reach, "rad")
        if not isinstance(self.name, str):
            raise InvalidValue("name", self.name, "must be a text")

    def for_robot(self, sms: SpaceManipulator) -> Via:
        """With the margin for this robot."""
        arm = ArmStack(sms)
        near = Near(arm, RobotFrame.tip(arm), self.place)
        return replace(self, margin=(1.0 - _NEAR) * self.reach / arm.length, _near=near)

    def timed(self, plan: Trajectory) -> Via:
        """With the time at which a plan comes nearest: for re-planning, which cannot see what was passed."""
        if self.place.rotation is not None:
            raise InvalidValue("place", self.place, "must be a position; give a pose its time yourself")
        way = np.linalg.norm(plan.end_effector - self.place.position, axis=1)
        return replace(self, time=float(plan.t[int(np.argmin(way))]))

    @property
    def _passed(self) -> bool:
        """Whether the time was before the motion began."""
        return self.time is not None and self.time < self.began

    def rows(self, step: StepState) -> Rows | None:
        """Until its time the end effector comes near as fast as it must; none without a time."""
        left = -1.0 if self.time is None else self.time - self.began - step.time
        if left < 0.0:
            return None
        return self._near.rows(step, [(_NEAR * self.reach, _NEAR * self.orientation_reach, left)])

    def residual(self, motions: Motions) -> Residuals:
        """By how much half of the reach is missed, in arm lengths; a turn by its share of its reach."""
        if self._passed:
            return []
        unit, at = 1.0 / motions.stack.length, self._passing(motions)
        allowed = (
            max(_NEAR * self.reach - self.reserve, 0.0),
            max(_NEAR * self.orientation_reach - self.reserve, 0.0),
        )
        scales = (unit, unit * self.reach / self.orientation_reach)
        where = np.arange(motions.count), at.instant
        return self._near.beyond(motions, where, at.missed, allowed, scales, at.later)

    def violation(self, motion: Motions) -> Violation:
        """By how much the nearest instant, or that of the time, misses [m or rad]."""
        if self._passed:
            return Violation()
        at = self._passing(motion)
        far, angle = float(at.missed.distance[0]), float(at.missed.angle[0])
        when = motion.times[at.instant] + at.later
        binds = max(far / self.reach, angle / self.orientation_reach) > _BINDING
        worst = max(far - self.reach, angle - self.orientation_reach)
        if worst <= 1e-9:
            return Violation(0.0, when if binds else np.empty(0))
        note = f"'{self.name}' is missed by {at.missed.words(0)}"
        return Violation(worst, when, f"{note} at {when[0]:.3g} s (reach {1e3 * self.reach:.3g} mm)")

    def _passing(self, motions: Motions) -> _Passing:
        """At its time, or where it comes nearest; from an instant on, the end effector goes straight."""
        times, motion = motions.times, np.arange(motions.count)
        velocity, spin = motions.velocity, motions.spin
        if self.time is not None:
            due = self.time - self.began
            k = np.full(motions.count, int(np.argmin(np.abs(times - due))))
            # After the deadline the arm stays where it is.
            h = np.full(motions.count, min(due, motions.duration) - times[k[0]])
        else:
            here = self._near.missed(motions)
            spin_across = here.along(spin)
            a, b = 1.0 / self.reach**2, 1.0 / self.orientation_reach**2
            along = a * dot(here.way, velocity) + b * dot(here.turn, spin_across)
            square = a * dot(velocity, velocity) + b * dot(spin_across, spin_across)
            h = np.clip(along / np.maximum(square, 1e-300), *_between(times))
            missed, turned = here.way - h * velocity, here.turn - h * spin_across
            k = np.argmin(a * dot(missed, missed) + b * dot(turned, turned), axis=1)
            h = h[motion, k]
        position = motions.end_effector[:, motion, k] + h * velocity[:, motion, k]
        attitude = apply(exp3(h * spin[:, motion, k]), motions.attitude[:, :, motion, k])
        return _Passing(k, h, self.place.missed(position, attitude))


def _between(times: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Half of the way to the neighbours of each instant, back and on [s]."""
    order = np.argsort(times, kind="stable")
    gaps = 0.5 * np.diff(times[order])
    back, on = np.zeros_like(times), np.zeros_like(times)
    back[order[1:]], on[order[:-1]] = -gaps, gaps
    return back, on
