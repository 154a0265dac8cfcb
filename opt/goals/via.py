"""A waypoint: where the end effector passes on its way, at a time or at any time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray, at_least_zero, positive
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.batch.motions import Motions
from ffsms_pin.opt.batch.residual import Indices, Residual, Residuals
from ffsms_pin.opt.goals.approach_rows import approach_row
from ffsms_pin.opt.goals.excess import excess, turn_excess
from ffsms_pin.opt.goals.goal import ORIENTATION_REACH, Place, resting_place
from ffsms_pin.opt.limits.limit import Limit, Rows, Violation, stacked
from ffsms_pin.opt.limits.step_state import StepState
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.batch.arm import ArmStack
from ffsms_pin.system.batch.stacks import apply, dot, exp3, log3

if TYPE_CHECKING:
    from ffsms_pin.opt.trajectory import Trajectory

__all__ = ["Via"]

_REACH = 0.01  # [m] half of the paper's r_th
_NEAR = 0.5  # share of the reach: nearer than that there is nothing to gain
_BINDING = 0.9  # share of the reach beyond which the limit binds
# How fast an arm is trusted to make up a way in steps [m/s, rad/s].
_SPEED, _SPIN = 0.05, 0.1


class _Passing(NamedTuple):
    """Where each of S motions passes: the instant, how much later [s], and what is missed then."""

    instant: Indices
    later: FloatArray
    way: FloatArray  # (3, S) [m]
    attitude: FloatArray  # (3, 3, S)
    angle: FloatArray  # (S,) [rad], zero where any attitude will do


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

    def __post_init__(self) -> None:
        if not isinstance(self.place, Place):
            object.__setattr__(self, "place", resting_place("place", self.place))
        if self.time is not None:
            at_least_zero("time", self.time, "s")
        positive("reach", self.reach, "m")
        positive("orientation_reach", self.orientation_reach, "rad")
        if not isinstance(self.name, str):
            raise InvalidValue("name", self.name, "must be a text")

    def for_robot(self, sms: SpaceManipulator) -> Via:
        """With the margin for this robot."""
        return replace(self, margin=(1.0 - _NEAR) * self.reach / ArmStack(sms).length)

    def tightened(self, by: float) -> Via:
        """Nearer by so much [m, rad]."""
        return replace(self, reserve=self.reserve + by)

    def later(self, by: float) -> Via:
        """For the rest of a motion: one whose time has passed asks for nothing more."""
        return replace(self, began=self.began + by)

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
        near = _NEAR * self.reach
        way = self.place.position - step.pose.translation
        J, drift, dt = step.J_star, step.tip_drift, step.dt
        rows = [approach_row(way, J[:3], step.rates, drift[:3], near, _SPEED, left, dt)]
        if self.place.rotation is not None:
            turn = log3((self.place.rotation @ step.pose.rotation.T)[..., None])[:, 0]
            near = _NEAR * self.orientation_reach
            rows.append(approach_row(turn, J[3:], step.rates, drift[3:], near, _SPIN, left, dt))
        return stacked(rows)

    def residual(self, motions: Motions) -> Residuals:
        """By how much half of the reach is missed, in arm lengths; a turn by its share of its reach."""
        if self._passed:
            return []
        length, at = motions.stack.length, self._passing(motions)
        found: Residuals = []
        beyond = excess(at.way, max(_NEAR * self.reach - self.reserve, 0.0))
        if beyond.value.size:
            s, slope = beyond.entry, -beyond.slope / length
            velocity = at.later[s] * slope
            where: dict[str, Any] = {"motion": s, "instants": at.instant[s], "over_time": False}
            found.append(Residual(beyond.value / length, by_tip=slope, by_velocity=velocity, **where))
        if self.place.rotation is not None:
            wanted = np.broadcast_to(self.place.rotation[..., None], at.attitude.shape)
            scale = self.reach / self.orientation_reach / length
            beyond = turn_excess(wanted, at.attitude, max(_NEAR * self.orientation_reach - self.reserve, 0.0))
            if beyond.value.size:
                s, k = beyond.entry, at.instant[beyond.entry]
                slope = scale * beyond.slope
                turned = exp3(at.later[s] * motions.spin[:, s, k])
                before = np.einsum("yxw,yw->xw", turned, slope)
                where = {"motion": s, "instants": k, "over_time": False}
                spin = at.later[s] * slope
                found.append(Residual(scale * beyond.value, by_turn=before, by_spin=spin, **where))
        return found

    def violation(self, motion: Motions) -> Violation:
        """By how much the nearest instant, or that of the time, misses [m or rad]."""
        if self._passed:
            return Violation()
        at = self._passing(motion)
        far, angle = float(np.linalg.norm(at.way[:, 0])), float(at.angle[0])
        when = motion.times[at.instant] + at.later
        binds = max(far / self.reach, angle / self.orientation_reach) > _BINDING
        worst = max(far - self.reach, angle - self.orientation_reach)
        if worst <= 1e-9:
            return Violation(0.0, when if binds else np.empty(0))
        note = f"'{self.name}' is missed by {1e3 * far:.1f} mm"
        if self.place.rotation is not None:
            note += f" and {np.degrees(angle):.2f} deg"
        return Violation(worst, when, f"{note} at {when[0]:.3g} s (reach {1e3 * self.reach:.3g} mm)")

    def _passing(self, motions: Motions) -> _Passing:
        """At its time, or where it comes nearest; from an instant on, the end effector goes straight."""
        times, motion = motions.times, np.arange(motions.count)
        way = self.place.position[:, None, None] - motions.end_effector
        velocity, spin = motions.velocity, motions.spin
        turn = np.zeros_like(way)
        rotation = self.place.rotation
        if rotation is not None:
            turn = log3(np.einsum("xy,zysk->xzsk", rotation, motions.attitude))
        if self.time is not None:
            due = self.time - self.began
            k = np.full(motions.count, int(np.argmin(np.abs(times - due))))
            # After the deadline the arm stays where it is.
            h = np.full(motions.count, min(due, motions.duration) - times[k[0]])
        else:
            a, b = 1.0 / self.reach**2, 0.0 if rotation is None else 1.0 / self.orientation_reach**2
            along = a * dot(way, velocity) + b * dot(turn, spin)
            square = a * dot(velocity, velocity) + b * dot(spin, spin)
            h = np.clip(along / np.maximum(square, 1e-300), *_between(times))
            missed, turned = way - h * velocity, turn - h * spin
            k = np.argmin(a * dot(missed, missed) + b * dot(turned, turned), axis=1)
            h = h[motion, k]
        attitude = apply(exp3(h * spin[:, motion, k]), motions.attitude[:, :, motion, k])
        angle = np.zeros(motions.count)
        if rotation is not None:
            angle = np.linalg.norm(log3(np.einsum("xy,zys->xzs", rotation, attitude)), axis=0)
        return _Passing(k, h, way[:, motion, k] - h * velocity[:, motion, k], attitude, angle)


def _between(times: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Half of the way to the neighbours of each instant, back and on [s]."""
    order = np.argsort(times, kind="stable")
    gaps = 0.5 * np.diff(times[order])
    back, on = np.zeros_like(times), np.zeros_like(times)
    back[order[1:]], on[order[:-1]] = -gaps, gaps
    return back, on
