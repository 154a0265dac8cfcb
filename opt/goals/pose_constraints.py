"""Constraints on poses of robot frames: at the deadline, at waypoints, and in the corridor to a grasp."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray, Indices, at_least_zero, instance, positive, set_frozen
from ffsms_pin.errors import InvalidValue, length_text
from ffsms_pin.opt.derivatives import FrameVariable, RobotFrame, Variable, Variables
from ffsms_pin.opt.evaluation import Rows, Violation
from ffsms_pin.opt.goals.goal import ORIENTATION_REACH, Goal, Place, PoseError, as_goal, deadzone
from ffsms_pin.opt.limits.limit import AllOf, FrameEnd, Inequality
from ffsms_pin.opt.rollouts import RecordedRollouts, Rollouts
from ffsms_pin.opt.step.state import StepState
from ffsms_pin.options import Angle, NotNegative, Positive, Text, Unit
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system.batch.stacks import dot

if TYPE_CHECKING:
    from ffsms_pin.opt.trajectory import Trajectory

AT_GRASP = 0.05  # share of the misalignment at the mouth that is allowed at the grasp
_BINDING = 0.05  # a limit is active if its slack is below this share of the reach (a waypoint: twice this)


class PoseConstraint:
    """A constraint on the pose of a frame of the robot relative to the places of a goal.

    The times of `goal` are those of the motion plus `Problem.time_offset`.
    """

    goal: Goal
    frame: str = "tip"

    def places(self, m: Variables) -> Place:
        """Return the places of the goal at the instants of `m`."""
        return self.goal.places(m.time_offset + m.times)

    def pose_error(self, m: Variables) -> PoseError:
        """Return the frame's pose error at the instants of `m`."""
        places = self.places(m)
        return places.pose_error(m.frame(self.frame, places.on))

    def reference(self, m: Variables) -> FrameVariable:
        """Return the poses of the goal as a frame.

        In a single step the frame has derivatives with respect to time.
        """
        places, moves, turns = self.places(m), {}, {}
        assert places.rotation is not None
        if m.step is not None:
            now = self.goal.place(m.time_offset + float(m.times[0]))
            moves, turns = ({"by_time": rate[:, None, None]} for rate in np.split(now.twist, 2))
        return FrameVariable(places.position[:, None], places.rotation[:, :, None], moves, turns, m.where)


class PoseTolerance(PoseConstraint, Inequality):
    """The limit on a frame's pose error relative to a goal, at the deadline or in the last tenth of the time.

    The reaches are the goal's tolerance at the deadline, and the goal's reaches in the last tenth of the
    time. The slack is in metres; slacks of angles are multiplied by `reach` / `orientation_reach`. If the
    error is within `share` of the reaches, less the additional margin of a search, the residual is zero.
    """

    def __init__(self, goal: Goal, frame: str, when: str) -> None:
        self.goal, self.frame, self.when, self.name = goal, frame, when, f"also {frame}"
        # The share 1 - `share` of the reaches is the margin for the difference between the spline and the
        # finished motion, and for the violation of a soft penalty.
        if when == "deadline":
            self.reach, self.orientation_reach, self.share = goal.tolerance, goal.tolerance, 0.4
            self.message = f"'{frame}' ends {{}} from its goal"
        else:
            self.reach, self.orientation_reach, self.share = goal.reach, goal.orientation_reach, 0.9
            self.message = f"'{frame}' is up to {{}} from its goal in the last tenth of the time"
        self.absolute_margin, self.active_below = (1.0 - self.share) * self.reach, _BINDING * self.reach

    def among(self, missed: list[Variable]) -> list[tuple[Variable, float]]:
        """Return the parts of a pose error, each with its reach."""
        return list(zip(missed, (self.reach, self.orientation_reach), strict=False))

    def errors_with_reaches(self, m: Variables) -> list[tuple[Variable, float]]:
        """Return the parts of the frame's pose error at the instants of `m`, each with its reach."""
        return self.among(self.pose_error(m).parts)

    def slack(self, m: Variables) -> Any:
        """Return the slack of each part of the pose error."""
        return [self.reach - (self.reach / most) * x.norm() for x, most in self.errors_with_reaches(m)]

    def residual(self, m: Variables) -> list[Variable]:
        """Return the pose error beyond `share` of the reaches, as vectors.

        The Gauss-Newton Hessian of a squared vector also has curvature perpendicular to the pose error, that
        of a squared length does not.
        """
        scale = self._scale_and_margin(m.rollouts)[0]
        residuals: list[Variable] = []
        for x, most in self.errors_with_reaches(self.at_active_instants(m)):
            part = self.reach / most
            excess = deadzone(x, max(self.share * most - self.bounded_margin(m) / part, 0.0)) * (part / scale)
            residuals += [excess.at_once()] if excess.value.any() else []
        return residuals

    def violation(self, motion: Rollouts) -> Violation:
        """Return the largest excess over a reach."""
        violation = super().violation(motion)
        if violation.amount == 0.0:
            return violation
        at = self.at_active_instants(Variables(motion))
        return violation._replace(note=self.message.format(self.pose_error(at).text(), at.times[0]))


def arrivals(goal: Goal, frame: str = "tip") -> list[PoseTolerance]:
    """Return a goal's limits on a frame at the deadline and in the last tenth of the time (const8)."""
    return [PoseTolerance(goal, frame, when) for when in ("deadline", "last tenth")]


@dataclass(frozen=True, eq=False)
class FrameGoal(AllOf):
    """A goal of another frame of the robot at the deadline, in addition to the end effector's goal.

    The pose error of the frame must be within the goal's `tolerance` at the deadline, and within the goal's
    `reach` and `orientation_reach` in the last tenth of the time. A plan that misses the goal has `reached`
    False, and its `note` contains the error.

    Attributes
    ----------
    frame : str
        Name of a frame of the robot: a link or a joint.
    goal : array_like, shape (3,) or (4, 4), pinocchio.SE3, opt.Position or opt.Pose
        The goal of the frame, fixed in space or on the base (`on="base"`).
    name : str
        The key in `Trajectory.binding`; by default "also FRAME".
    """

    frame: str
    goal: Any
    margin: float = 0.0
    name: str = ""
    ends: Sequence[FrameEnd] = ()
    of_paper = False

    def __post_init__(self) -> None:
        instance("frame", self.frame, str)
        set_frozen(self, goal=standing_goal(self.goal, "goal"), name=self.name or f"also {self.frame}")

    def for_robot(self, sms: SpaceManipulator) -> FrameGoal:
        """Return the goal with the frame of a robot, and with the margin as a share of the arm length."""
        end, _ = arrivals(self.goal, self.frame)
        ends = [FrameEnd(RobotFrame.of(sms.arm_stack(), self.frame), self.goal.place(0.0))]
        return replace(self, margin=(1.0 - end.share) * end.reach / sms.arm_stack().length, ends=ends)

    @property
    def parts(self) -> list[Inequality]:
        """The limits at the deadline and in the last tenth of the time, scaled to the same margin."""
        constraints = arrivals(self.goal, self.frame)
        for constraint in constraints:
            constraint.scale = (1.0 - constraint.share) * constraint.reach / (self.margin or 1.0)
        return [*constraints]

    def pose_errors(self, motion: Rollouts) -> FloatArray:
        """Return distance [m] and angle [rad] of the frame from its goal at all instants (K, 2)."""
        return pose_errors(self.goal, Variables(motion), self.frame)

    def violation_in_flight(self, motion: RecordedRollouts) -> Violation:
        """Return a violation by the goal's `reach` [m] if the frame exceeds a reach at the last row."""
        error = self.pose_errors(motion)[-1]
        note = end_miss(self.goal, error, f"'{self.frame}'")
        return Violation(self.goal.reach if note else 0.0, note=note)


@dataclass(frozen=True, eq=False)
class Waypoint(PoseTolerance):
    """A waypoint of the end effector, at a given time or at any time before the deadline.

    Several waypoints need different names. The order of waypoints without a time is free.

    Raises
    ------
    InvalidValue
        If a value is out of range or has a wrong shape.
    """

    place: Any
    """The fixed position (3,) [m] or pose, inertial axes."""
    time: Annotated[NotNegative | None, Unit("s", "any")] = None
    """The time of the waypoint from the start of the motion, at most the duration. Single steps ignore a
    waypoint without a time, because a step cannot determine whether the waypoint was passed."""
    reach: Annotated[Positive, Unit("m")] = 0.01  # half of the paper's r_th
    """The position tolerance."""
    orientation_reach: Annotated[Positive, Angle("rad")] = ORIENTATION_REACH
    """The attitude tolerance, if the place is a pose."""
    name: Annotated[Text, Unit()] = "via"
    """The name, for messages and for `Trajectory.binding`."""
    margin: float = 0.0
    of_paper = False
    share = 0.5

    def __post_init__(self) -> None:
        if not isinstance(self.place, Place):
            object.__setattr__(self, "place", inertial_place(self.place, "place"))
        if self.time is not None:
            at_least_zero("time", self.time, "s")
        positive("reach", self.reach, "m")
        positive("orientation_reach", self.orientation_reach, "rad")
        instance("name", self.name, str)
        message = f"'{self.name}' is missed by {{}} at {{:.3g}} s (reach {length_text(self.reach)})"
        set_frozen(
            self,
            absolute_margin=(1.0 - self.share) * self.reach,
            active_below=2.0 * _BINDING * self.reach,
            message=message,
        )

    def for_robot(self, sms: SpaceManipulator) -> Waypoint:
        """Return the waypoint with the margin as a share of the robot's arm length."""
        return replace(self, margin=(1.0 - self.share) * self.reach / sms.arm_stack().length)

    def timed(self, plan: Trajectory) -> Waypoint:
        """Return the waypoint with the time at which a plan is nearest to its position, for re-planning.

        `InvalidValue` is raised if the waypoint is a pose.
        """
        if np.isfinite(self.place.attitude).all():
            remedy = f"of '{self.name}' must be a position for re-planning, unless it has a time"
            raise InvalidValue("place", self.place, remedy)
        distances = np.linalg.norm(plan.end_effector - self.place.position, axis=1)
        return replace(self, time=float(plan.t[int(np.argmin(distances))]))

    def places(self, m: Variables) -> Place:
        """Return the waypoint's place, which is fixed."""
        place: Place = self.place
        return place

    def time_until_active(self, step: StepState) -> float:
        """Return the time from the step's start to the waypoint [s]; negative if it is past or not set."""
        return -1.0 if self.time is None else self.time - step.time_offset - step.time

    def rows(self, step: StepState) -> Rows | None:
        """Return the rows of the limit until the waypoint's time; none without a time."""
        return super().rows(step) if self.time_until_active(step) >= 0.0 else None

    def errors_with_reaches(self, m: Variables) -> list[tuple[Variable, float]]:
        """Return the parts of the pose error, each with its reach; none if the waypoint's time is past."""
        return [] if self.time is not None and self.time < m.time_offset else super().errors_with_reaches(m)

    def at_active_instants(self, m: Variables) -> Variables:
        """Return each motion at the waypoint's time, or without a time, where it is nearest to the waypoint.

        From the nearest instant, the motion is extrapolated at constant velocities.
        """
        times, motion = m.times, np.arange(m.count)
        if self.time is None:
            k, delay = self._nearest(m)
        else:
            due = self.time - m.time_offset
            k = np.full(m.count, int(np.argmin(np.abs(times - due))))
            delay = min(due, m.duration) - times[k]  # the arm rests after the deadline
        at = m.at(motion, k)
        at.tip = at.tip.moving_on(at.velocity, at.angular_velocity, delay[None])
        at.rollouts = replace(at.rollouts, times=at.times + delay)
        return at

    def _nearest(self, m: Variables) -> tuple[Indices, FloatArray]:
        """Return the instants (S,) nearest to the waypoint, and the delays (S,) [s] to the nearest points.

        Distances and angles are measured as shares of their reaches.
        """
        speeds = (m.velocity.value, self.place.without_free_axis(m.angular_velocity.value))
        parts = zip(self.errors_with_reaches(m), speeds, strict=False)
        errors = [(x.value / most, v / most) for (x, most), v in parts]
        along = sum(dot(x, v) for x, v in errors)
        square = sum(dot(v, v) for _, v in errors)
        order = np.argsort(m.times, kind="stable")
        gaps, least, most = 0.5 * np.diff(m.times[order]), np.zeros_like(m.times), np.zeros_like(m.times)
        least[order[1:]], most[order[:-1]] = -gaps, gaps  # at most half of the gap to a neighbour
        delay = np.clip(along / np.maximum(square, 1e-300), least, most)
        squares = sum(dot(x - delay * v, x - delay * v) for x, v in errors)
        k = np.argmin(squares, axis=1)
        return k, delay[np.arange(m.count), k]


_STANDING = "a position (3,) [m], a pinocchio.SE3 or a matrix (4, 4), an opt.Position or an opt.Pose"


def standing_goal(value: Any, name: str, kinds: str = _STANDING) -> Goal:
    """Return the goal for a position, a pose or a goal.

    `InvalidValue` is raised if the goal moves or has a velocity.
    """
    goal = as_goal(value, name, kinds)
    if goal.moves or not goal.place(0.0).rests:
        raise InvalidValue(name, value, "must be fixed, without a velocity")
    return goal


def inertial_place(value: Any, name: str, kinds: str = _STANDING) -> Place:
    """Return the place of a goal as for `standing_goal`; raise `InvalidValue` if it is on the base."""
    place = standing_goal(value, name, kinds).place(0.0)
    if place.moves_with_base:
        raise InvalidValue(name, value, "must be in inertial axes")
    return place


class GoalErrors(NamedTuple):
    """The errors of a finished motion relative to its goal."""

    distance: FloatArray  # (N + 1,) from the desired position at the nodes [m]
    angle: FloatArray  # (N + 1,) from the desired attitude at the nodes [rad]
    contact: FloatArray  # (6,) twist at the deadline relative to the desired twist [m/s; rad/s]
    misses: str  # the message if errors at the deadline exceed the tolerance; else empty
    late: str  # the message if errors in the last tenth of the time exceed the reaches; else empty


def verdict(goal: Goal, motion: Rollouts) -> GoalErrors:
    """Return the errors of a finished motion relative to its goal, evaluated at the nodes."""
    m, place, last = Variables(motion), goal.place(motion.duration), motion.last
    places = goal.places(motion.times)
    missed = places.pose_error(m.frame("tip", places.on))
    distance, angle = missed.distance[0, ::2], missed.angle[0, ::2]
    moving = [motion.velocity[:, 0, last], motion.angular_velocity[:, 0, last]]
    contact: FloatArray = np.concatenate(moving) - place.twist
    errors = end_errors(goal, float(distance[-1]), float(angle[-1]), contact, motion.duration)
    nodes = motion.last_tenth[motion.last_tenth % 2 == 0] // 2
    far, turned, late = float(distance[nodes].max()), float(angle[nodes].max()), ""
    if far > goal.reach or turned > goal.orientation_reach:
        both = (far, turned), (goal.reach, goal.orientation_reach)
        most, allowed = (f"{length_text(length)} and {math.degrees(turn):.3g} deg" for length, turn in both)
        late = f"too late: up to {most} off in the last tenth of the time, where {allowed} are allowed"
    return GoalErrors(distance, angle, contact, end_misses(goal, errors), late)


def pose_errors(goal: Goal, m: Variables, frame: str) -> FloatArray:
    """Return distance [m] and angle [rad] of a frame from a goal at every instant of one motion (K, 2)."""
    places = goal.places(m.times)
    error = places.pose_error(m.frame(frame, places.on))
    return np.column_stack([error.distance[0], error.angle[0]])


def end_miss(goal: Goal, error: FloatArray, frame: str) -> str:
    """Return a message if a final distance or angle, `error` (2,), exceeds the goal's reach; else empty."""
    if error[0] <= goal.reach and error[1] <= goal.orientation_reach:
        return ""
    turned = goal.place(0.0).rotation is not None
    both = [length_text(error[0])] + [f"{math.degrees(error[1]):.3g} deg"] * turned
    most = [length_text(goal.reach)] + [f"{math.degrees(goal.orientation_reach):.3g} deg"] * turned
    return f"{frame} ends {' and '.join(both)} from its goal, {' and '.join(most)} are allowed"


def end_errors(goal: Goal, distance: float, angle: float, contact: FloatArray, duration: float) -> FloatArray:
    """Return errors of position, attitude and both velocities at the deadline (4,) [m, rad, m/s, rad/s].

    The error of an unconstrained velocity is zero, unless the goal is exact. For `contact` see `GoalErrors`.
    """
    place, velocities = goal.place(duration), np.linalg.norm(np.split(contact, 2), axis=1)
    constrained = [goal.exact or v is not None for v in (place.velocity, place.angular_velocity)]
    return np.array([distance, angle, *velocities * constrained])


def end_misses(goal: Goal, errors: FloatArray) -> str:
    """Return a message with `errors` of `end_errors`; empty if all are within the tolerance."""
    if not errors.max() > goal.tolerance:
        return ""
    units = zip(errors, (1e3, math.degrees(1.0)) * 2, ("mm", "deg", "mm/s", "deg/s"), strict=True)
    shown = [(error, size, unit) for error, size, unit in units if goal.exact or error > 0.0]
    errors_text = ", ".join(f"{size * error:.3g} {unit}" for error, size, unit in shown)
    allowed = ", ".join(f"{size * goal.tolerance:.2g} {unit}" for _, size, unit in shown)
    what = "at contact the grasp is missed by" if goal.exact else "the end is off by"
    return f"{what} {errors_text}; its tolerance is {allowed}"


@dataclass(frozen=True, eq=False)
class Corridor(PoseConstraint, Inequality):
    """The limit that keeps the end effector inside a cone, fixed to a grasp, while it is near the grasp.

    The forbidden region is a ball around the grasp, except the cone. The slack [m] is the larger of the depth
    inside the cone and the distance outside the ball.

    Attributes
    ----------
    goal : Goal
        The grasp, a goal whose places are poses.
    deadline : float
        The motion's deadline in the times of `goal` [s].
    length, half_angle : float
        The length of the cone, which is the radius of the ball [m], and its half angle [rad].
    axis : ndarray, shape (3,)
        Unit vector of the direction of approach, in grasp axes.
    tolerance : float
        The position tolerance at the tip of the cone [m].
    inside : float
        The time before the deadline during which whole motions must be inside the cone at any distance [s].
        With a shorter time a search might push instants out of the ball on the wrong side.
    """

    goal: Goal
    deadline: float
    length: float
    half_angle: float
    axis: FloatArray
    tolerance: float
    inside: float
    name = "corridor"
    refusal = "the start is outside the corridor: {note}; move the start, or set a shorter standoff"
    margin = 4e-3  # [arm lengths] because a motion may cut the cone's edge between two instants
    step_margin = 0.0
    # [m] the accepted violation, for the same reason; it is also added to the margin
    accuracy = 5e-5
    active_below = 1e-3

    def slack(self, m: Variables) -> Any:
        """Return the larger of the depth inside the cone and the distance outside the ball."""
        cone, far = self._depth_and_distance(m)
        return np.maximum(cone, far - self.length)

    def margin_violation(self, m: Variables) -> Any:
        """Return the violation of the margin by whole motions, negative if the margin is kept.

        The margin decreases linearly to `accuracy` at the cone's tip.
        """
        cone, far = self._depth_and_distance(m)
        late = m.times + m.time_offset >= self.deadline - self.inside
        ball = far - np.where(late, math.inf, self.length)[None]
        absolute_margin = self.margin * m.stack.length + m.extra_margin
        return self.accuracy + absolute_margin * np.minimum(far / self.length, 1.0) - np.maximum(cone, ball)

    def _depth_and_distance(self, m: Variables) -> tuple[Variable, Variable]:
        """Return the depth of the end effector inside the cone, and its distance from the grasp [m]."""
        grasp = self.reference(m)
        displacement, axis = m.frame(self.frame) - grasp, grasp.axis(self.axis)
        along = displacement.dot(axis)
        beside = (displacement - along * axis).norm()
        c, s = math.cos(self.half_angle), math.sin(self.half_angle)
        return self.tolerance - c * beside - s * along, displacement.norm()

    def note(self, slack: float, time: float) -> str:
        """Return the message for a motion that leaves the corridor."""
        cone = f"half angle {math.degrees(self.half_angle):.3g} deg within {self.length:.3g} m of the grasp"
        return f"the approach is {-1e3 * slack:.1f} mm outside its corridor at {time:.3g} s ({cone})"


def compared_axes(axis: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return `axis` (3,), the unit vector of approach, and a unit vector (3,) perpendicular to it."""
    across = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    return axis, across / np.linalg.norm(across)


@dataclass(frozen=True, eq=False)
class Alignment(Corridor):
    """A bound on the rotation of the end effector relative to the grasp while it is in the corridor.

    The bound applies to the angle between the axes of approach of both frames, and to the angle between two
    axes perpendicular to them. It is `half_angle` at the distance `length` from the grasp, and decreases
    linearly to a twentieth of this value at the grasp. An angle is approximated by the distance between the
    unit vectors of its axes, which is smaller for large angles. The slack is an angle times `length` [m].
    """

    name = "alignment"
    accuracy = 1e-3  # [m] a tenth of a degree in a corridor of 0.5 m
    refusal = "the start is misaligned in the corridor: {note}; move the start, or set a shorter standoff"

    def _depth_and_distance(self, m: Variables) -> tuple[Variable, Variable]:
        """Return the allowed minus the present angle, times `length` [m], and the distance from the grasp."""
        grasp, tip = self.reference(m), m.frame(self.frame)
        far = (tip - grasp).norm()
        along, across = ((tip.axis(axis) - grasp.axis(axis)).norm() for axis in compared_axes(self.axis))
        allowed = self.half_angle * (AT_GRASP * self.length + (1.0 - AT_GRASP) * far)
        turned: Variable = np.maximum(along, across)  # type: ignore[assignment]
        return allowed - self.length * turned, far

    def note(self, slack: float, time: float) -> str:
        """Return the message for an end effector that is misaligned in the corridor."""
        turned = f"{math.degrees(-slack / self.length):.3g} deg more than its distance from the grasp allows"
        limit = f"{math.degrees(self.half_angle):.3g} deg at {self.length:.3g} m"
        return f"the end effector is turned by {turned} at {time:.3g} s ({limit})"
