"""The goal to follow a path with the end effector during the whole motion, and its limit."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin import checks
from ffsms_pin.checks import FloatArray
from ffsms_pin.client import FreeBody
from ffsms_pin.errors import InvalidValue, length_text
from ffsms_pin.opt.derivatives import BASE, INERTIAL, Variable, Variables
from ffsms_pin.opt.evaluation import Rows, Violation
from ffsms_pin.opt.goals.curves import (
    Curve,
    EvenCurve,
    FunctionCurve,
    Points,
    SampledCurve,
    TimeLaw,
    check_jumps,
    even_shares,
    lengths,
    sample_times,
    sampled_points,
)
from ffsms_pin.opt.goals.goal import REACH, TOLERANCE, Goal, Place, PoseError, check_reaches
from ffsms_pin.opt.goals.named_curves import NamedCurve
from ffsms_pin.opt.goals.pose_constraints import PoseConstraint
from ffsms_pin.opt.limits.limit import Limit
from ffsms_pin.opt.rollouts import RecordedRollouts, Rollouts
from ffsms_pin.opt.step.state import StepState
from ffsms_pin.options import Angle, NotNegative, Numbers, Positive, Unit, Vector3
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system.batch.stacks import exp3, log3

if TYPE_CHECKING:
    from ffsms_pin.opt.problem import Problem

_STEP = 1e-3  # [s] step of finite differences for velocities along a path
_CHECKED = 401  # number of times at which a path is checked before planning


class PathMotion(NamedTuple):
    """The places of a path at K times, with velocities (3, K) [m/s] and angular velocities (3, K) [rad/s].

    Angular velocities are None if the path has no attitudes. Places and velocities are in the axes `Path.on`.
    """

    place: Place
    velocities: FloatArray
    angular_velocities: FloatArray | None


@dataclass(frozen=True, eq=False)
class Path(Goal):
    """A path that the end effector follows during the whole motion, within `tolerance` at every instant.

    A problem with this goal has the limit "path" (`OnPath`); if a plan violates it, `reached` is False.
    """

    curve: Any
    """The curve: a function that returns a position (3,) [m], a pinocchio.SE3 or a homogeneous matrix (4, 4);
    or samples of these, joined by cubic splines: (K, 3), K poses, or (K, 4, 4). The argument of a function is
    the time [s] from the path's start, or a parameter if `parameter` has its range. `opt.Line`, `Circle`,
    `Helix` and `RoundedSquare` are geometric curves."""
    times: Annotated[Numbers | None, Unit("s", "none: a geometric curve")] = None
    """The times of the samples, beginning at zero. Samples without times are a geometric curve. If the motion
    ends before the last sample, the end of the path is not followed, and the plan has a note."""
    parameter: Any = None
    """The first and the last value of the function's parameter. The function is then a geometric curve.
    Default: (0, 1) for `opt.Line`, `Circle`, `Helix` and `RoundedSquare`."""
    tolerance: Annotated[Positive, Unit("m")] = TOLERANCE
    """The largest distance from the path's point at the same time."""
    orientation_tolerance: Annotated[Positive, Angle("rad")] = 0.01
    """The largest angle from the attitude of a path of poses."""
    free_axis: Annotated[Vector3 | None, Unit("", "none")] = None
    """The axis, in the axes of the end-effector frame, about which rotation is free."""
    frame: Any = INERTIAL
    """The axes of the curve: "inertial"; "base", the base link's frame; or the body axes of a Client or a
    capture.ClientEstimate. In the last two cases the path moves with these axes."""
    timing: Annotated[Literal["given", "fastest"], Unit()] = "given"
    """The time law of a geometric curve. "given": constant speed from the end of the approach to the
    deadline, with a smooth start and end. "fastest": the least time, at most the problem's duration, within
    the limits that bound the speed (`Limit.speed_bound`). These are limits on joint rates, accelerations and
    torques, and on wheels, on the base's angular speed and on alpha if the problem has them."""
    approach_time: Annotated[NotNegative, Unit("s")] = 0.0
    """The time before the path's start in which the end effector moves from rest to the path and reaches the
    path's velocity, along a quintic polynomial. Zero: the motion begins on the path."""
    reach: Annotated[Positive, Unit("m")] = REACH
    """The position tolerance of a flown motion on the path."""
    orientation_reach: Annotated[Positive, Angle("rad")] = 0.05
    """The attitude tolerance of a flown motion on a path of poses."""
    duration: float | None = None  # the motion's duration [s]; a problem sets it together with `begin`
    begin: Any = None  # the end effector's start pose (pinocchio.SE3) in the axes `on`
    law: TimeLaw | None = None  # time law of a geometric curve, set by the planner; None: `even_shares`
    moves: ClassVar[bool] = True
    coupled: ClassVar[bool] = False  # the path determines the motion

    def __post_init__(self) -> None:
        check_reaches(self)
        if isinstance(self.curve, NamedCurve) and self.parameter is None:
            checks.set_frozen(self, parameter=(0.0, 1.0))
        checks.positive("orientation_tolerance", self.orientation_tolerance, "rad")
        checks.at_least_zero("approach_time", self.approach_time, "s")
        checks.one_of("timing", self.timing, ("given", "fastest"))
        if not isinstance(self.frame, FreeBody) and self.frame not in (INERTIAL, BASE):
            remedy = 'must be "inertial", "base", a Client or a capture.ClientEstimate'
            raise InvalidValue("frame", self.frame, remedy)
        if self.timing == "fastest" and not self.geometric:
            remedy = (
                'can be "fastest" only for a geometric curve: leave out `times`, or give parameter=(a, b)'
            )
            raise InvalidValue("timing", self.timing, remedy)
        if self.timing == "fastest" and not isinstance(self.frame, str):
            remedy = 'can be "fastest" only in inertial axes or on the base; on a client set timing="given"'
            raise InvalidValue("timing", self.timing, remedy)
        if self.free_axis is not None:
            checks.set_frozen(self, free_axis=checks.direction("free_axis", self.free_axis))
            if self._first.rotations is None:
                remedy = "must be left out of a path of positions, which admits any attitude"
                raise InvalidValue("free_axis", self.free_axis, remedy)
        self._first  # noqa: B018  # raises if the curve cannot be evaluated

    @property
    def geometric(self) -> bool:
        """True if the curve has no times of its own."""
        return self.parameter is not None or (not callable(self.curve) and self.times is None)

    @cached_property
    def _curve(self) -> Curve:
        """The curve as a function of time [s], or of the share of its length if it is geometric."""
        if not callable(self.curve):
            points = sampled_points(self.curve)
            if self.parameter is not None:
                remedy = "must be left out if the curve is samples, which may have `times`"
                raise InvalidValue("parameter", self.parameter, remedy)
            if self.times is None:
                along = lengths(points)
                if (np.diff(along) <= 0.0).any():
                    k = int(np.argmin(np.diff(along)))
                    remedy = f"must not repeat a sample; remove curve[{k + 1}]"
                    raise InvalidValue("curve", points.positions[:, k + 1], remedy)
                return EvenCurve(SampledCurve(along, points), 0.0, float(along[-1]))
            return SampledCurve(sample_times(self.times, points.positions.shape[1]), points)
        if self.times is not None:
            remedy = "must be left out unless the curve is samples"
            raise InvalidValue("times", self.times, remedy)
        if self.parameter is None:
            return FunctionCurve(self.curve, 0.0)
        first, last = checks.vector("parameter", self.parameter, 2)
        if first == last:
            raise InvalidValue("parameter", self.parameter, "must be two different values")
        return EvenCurve(FunctionCurve(self.curve, first), first, last)

    @cached_property
    def _first(self) -> Points:
        """The first point of the curve."""
        return self._curve(np.zeros(1))

    @cached_property
    def _recent(self) -> dict[bytes, Points]:
        """The points of the curve at recently evaluated times, in the axes of `frame`."""
        return {}

    @property
    def turned(self) -> bool:
        """True if the path has attitudes."""
        return self._first.rotations is not None

    @property
    def on(self) -> str:
        """The axes of the path's places: inertial axes, or base axes."""
        return BASE if isinstance(self.frame, str) and self.frame == BASE else INERTIAL

    def for_motion(self, sms: SpaceManipulator, q0: FloatArray, duration: float) -> Path:
        """Return the path for a motion from q0 (nq,) that lasts `duration` [s].

        `InvalidValue` is raised if the curve jumps, if its samples end before the motion, or if the motion
        does not last longer than the approach.
        """
        if duration <= self.approach_time:
            remedy = f"must be shorter than the motion, which lasts {duration:g} s"
            raise InvalidValue("approach_time", self.approach_time, remedy)
        pose = sms.at(q0).end_effector_pose
        if self.on == BASE:
            pose = pin.XYZQUATToSE3(q0[:7]).actInv(pose)
        path = copy(self)  # shares the curve, whose table of lengths has a thousand points
        checks.set_frozen(path, duration=duration, begin=pose, _recent={})
        last = duration - self.approach_time
        if not callable(self.curve) and self.times is not None and last > float(self.times[-1]) + 1e-9:
            after = " after the approach" if self.approach_time else ""
            remedy = (
                f"must reach the end of the motion at {last:g} s{after}; add samples, or shorten the "
                f"duration to {float(self.times[-1]) + self.approach_time:g} s"
            )
            raise InvalidValue("times", float(self.times[-1]), remedy)
        if duration != self.duration:  # otherwise the curve has been checked
            end, unit = (1.0, "of its length") if self.geometric else (last, "s")
            check_jumps(self._curve, np.linspace(0.0, end, _CHECKED), unit)
        return path

    @property
    def rest(self) -> float:
        """The time from the motion's deadline to the last sample [s]; zero without times or `duration`."""
        if callable(self.curve) or self.times is None or self.duration is None:
            return 0.0
        return max(float(self.times[-1]) - (self.duration - self.approach_time), 0.0)

    def slower(self, scale: float) -> Path:
        """Return the path with the times of curve and approach multiplied by `scale`."""
        path = replace(self, approach_time=scale * self.approach_time, duration=None, begin=None)
        if self.geometric:
            return replace(path, law=None if self.law is None else self.law.slower(scale))
        if callable(self.curve):
            curve = self.curve
            return replace(path, curve=lambda t: curve(t / scale))
        return replace(path, times=scale * np.asarray(self.times, dtype=np.float64))

    def along(self, t: FloatArray) -> Points:
        """Return the points of the path at times (K,) after its start [s], in the axes of `frame`."""
        key = t.tobytes()
        if (points := self._recent.get(key)) is None:  # searches evaluate the same times often
            if self.geometric:
                assert self.duration is not None
                last = self.duration - self.approach_time
                t = even_shares(t / last) if self.law is None else self.law(t)
            if len(self._recent) >= 8:
                self._recent.clear()
            self._recent[key] = points = self._curve(t)
        return points

    def _in_axes(self, points: Points, times: FloatArray) -> Points:
        """Transform points at times (K,) of the motion from the axes of `frame` to the axes `on`."""
        if isinstance(self.frame, str):
            return points
        place, turn = self.frame.poses(times)
        positions = place.T + np.einsum("kxy,yk->xk", turn, points.positions)
        if points.rotations is None:
            return Points(positions)
        return Points(positions, np.einsum("kxy,yzk->xzk", turn, points.rotations))

    def points(self, times: FloatArray) -> Points:
        """Return the points at times (K,) of the motion [s], the approach included."""
        # After the deadline the point of the curve stays the same, but `frame` may move on.
        until = np.inf if self.duration is None else self.duration
        t = np.minimum(times, until) - self.approach_time
        on_path = self._in_axes(self.along(np.maximum(t, 0.0)), np.maximum(times, self.approach_time))
        before = t < 0.0
        if not before.any() or self.begin is None:
            return on_path
        approach, positions = self._approach(times[before]), on_path.positions.copy()
        positions[:, before] = approach.positions
        if on_path.rotations is None:
            return Points(positions)
        rotations = on_path.rotations.copy()
        rotations[..., before] = approach.rotations
        return Points(positions, rotations)

    def _approach(self, times: FloatArray) -> Points:
        """Return the points of the approach: quintic polynomials from rest to the state of the path."""
        h, T = 1e-2, self.approach_time
        at = np.array([0.0, h, 2.0 * h])
        ends = self._in_axes(self.along(at), T + at)

        def polynomial(first: FloatArray, values: FloatArray) -> FloatArray:
            """Return values of a quintic polynomial from rest at `first` (3,) to the state of the path.

            `values` (3, 3) are the path's positions or rotation vectors at its first three instants, h apart.
            """
            end, velocity = (
                values[:, 0],
                (-3.0 * values[:, 0] + 4.0 * values[:, 1] - values[:, 2]) / (2.0 * h),
            )
            acceleration = (values[:, 0] - 2.0 * values[:, 1] + values[:, 2]) / h**2
            travel, v, a = end - first, velocity * T, acceleration * T**2
            c = (
                10.0 * travel - 4.0 * v + 0.5 * a,
                -15.0 * travel + 7.0 * v - a,
                6.0 * travel - 3.0 * v + 0.5 * a,
            )
            x = times / T
            return np.asarray(
                first[:, None] + sum(np.outer(coefficient, x**k) for k, coefficient in enumerate(c, start=3))
            )

        positions = polynomial(self.begin.translation, ends.positions)
        if ends.rotations is None:
            return Points(positions)
        R = ends.rotations
        first = pin.log3(self._begin_rotation(R[..., 0]) @ R[..., 0].T)
        turns = polynomial(first, log3(np.einsum("xyk,zy->xzk", R, R[..., 0])))
        return Points(positions, np.einsum("xyk,yz->xzk", exp3(turns), R[..., 0]))

    def _begin_rotation(self, first: FloatArray) -> FloatArray:
        """Return the initial attitude of an approach to the path's first attitude `first` (3, 3).

        With a free axis, the result is the attitude nearest to `first` in which this axis has the direction
        that it has at the motion's start.
        """
        if self.free_axis is None:
            return np.asarray(self.begin.rotation)
        now, then = self.begin.rotation @ self.free_axis, first @ self.free_axis
        turn = pin.Quaternion.FromTwoVectors(now, then).toRotationMatrix()
        return np.asarray(turn.T @ first)

    def places(self, times: FloatArray) -> Place:
        """Return the places at times (K,) of the motion [s], the approach included."""
        points = self.points(times)
        return Place(points.positions, points.rotations, None, None, self.free_axis, self.on)

    def motion(self, times: FloatArray) -> PathMotion:
        """Return places and velocities at times (K,) of the motion [s]."""
        last = np.inf if self.duration is None else self.duration
        behind, ahead = np.maximum(times - _STEP, 0.0), times + _STEP
        ahead = np.where(times <= last, np.minimum(ahead, last), ahead)
        before, after = self.points(behind), self.points(ahead)
        span = ahead - behind
        velocities = (after.positions - before.positions) / span
        angular_velocities = None
        if before.rotations is not None and after.rotations is not None:
            angular_velocities = log3(np.einsum("xyk,zyk->xzk", after.rotations, before.rotations)) / span
        return PathMotion(self.places(times), velocities, angular_velocities)

    def place(self, t: float) -> Place:
        """Return the place at a time of the motion [s].

        The place has the path's velocity and, if the path has attitudes and no free axis, its angular
        velocity. On the base it has neither.
        """
        place, velocities, angular_velocities = self.motion(np.array([t]))
        rotation = None if place.rotation is None else place.rotation[..., 0]
        angular_velocity = (
            None if angular_velocities is None or self.free_axis is not None else angular_velocities[:, 0]
        )
        velocity = None if self.on == BASE else velocities[:, 0]
        angular_velocity = None if self.on == BASE else angular_velocity
        return replace(
            place,
            position=place.position[:, 0],
            rotation=rotation,
            velocity=velocity,
            angular_velocity=angular_velocity,
        )

    def limits(self, duration: float) -> tuple[Limit, ...]:
        """Return the limit that keeps the end effector on the path."""
        return (OnPath(self),)


class OnPath(PoseConstraint, Limit):
    """The limit that keeps the end effector on a path, within its tolerances at every instant."""

    goal: Path
    name = "path"

    def __init__(self, goal: Path) -> None:
        self.goal = goal
        self.tolerance, self.orientation_tolerance = goal.tolerance, goal.orientation_tolerance
        # The penalty is soft, because a rollout after the descent returns the end effector to the path. The
        # margin in metres, `margin` times `scale`, equals the tolerance.
        self.scale = 5e4 * self.tolerance
        self.margin = self.tolerance / self.scale

    def rows(self, step: StepState) -> Rows | None:
        """Return no rows, because the objective of single steps follows the path."""
        return None

    def residual(self, m: Variables) -> list[Variable]:
        """Return the pose errors without a deadzone, so that a descent changes only the redundant motion.

        An error as large as its tolerance has a residual equal to `margin`.
        """
        tolerances = (self.tolerance, self.orientation_tolerance)
        parts = zip(self.pose_error(m).parts, tolerances, strict=False)
        return [x * (self.margin / tolerance) for x, tolerance in parts]

    def violation(self, motion: Rollouts) -> Violation:
        """Return the largest excess over a tolerance [m].

        The excess of an angle is multiplied by `tolerance` / `orientation_tolerance`.
        """
        m = Variables(motion)
        error = self.pose_error(m)
        share = np.maximum(error.distance[0] / self.tolerance, error.angle[0] / self.orientation_tolerance)
        k = int(np.argmax(share))
        instants = motion.times[share > 0.95]
        if share[k] <= 1.0:
            return Violation(0.0, instants)
        return Violation(self.tolerance * float(share[k] - 1.0), instants, self._note(error, k, motion))

    def violation_in_flight(self, motion: RecordedRollouts) -> Violation:
        """Return the largest excess over a reach of the goal [m].

        The excess of an angle is multiplied by `reach` / `orientation_reach`.
        """
        error, goal = self.pose_error(Variables(motion)), self.goal
        share = np.maximum(error.distance[0] / goal.reach, error.angle[0] / goal.orientation_reach)
        k = int(np.argmax(share))
        if share[k] <= 1.0:
            return Violation()
        off = f"{length_text(error.distance[0, k])} and {np.degrees(error.angle[0, k]):.3g} deg"
        most = f"{length_text(goal.reach)} and {np.degrees(goal.orientation_reach):.3g} deg"
        note = f"the end effector was {off} off its path at {motion.times[k]:.3g} s, {most} are allowed"
        return Violation(goal.reach * float(share[k] - 1.0), note=note)

    def _note(self, error: PoseError, k: int, motion: Rollouts) -> str:
        """Return the message for a motion that is off the path at instant k."""
        by, most = length_text(error.distance[0, k]), length_text(self.tolerance)
        if self.goal.turned:
            by += f" and {np.degrees(error.angle[0, k]):.3g} deg"
            most += f" and {np.degrees(self.orientation_tolerance):.3g} deg"
        time = motion.times[k]
        part = " (during the approach)" if time + motion.time_offset < self.goal.approach_time else ""
        return f"the end effector is {by} off the path at {time:.3g} s{part}, where {most} are allowed"


_FINER = 5  # factor on the number of steps; with midpoints there are ten instants per step


class PathErrors(NamedTuple):
    """The errors of a motion along a path, evaluated at ten instants per step."""

    distance: FloatArray  # (N + 1,) the largest distance within half a step of each node [m]
    angle: FloatArray  # (N + 1,) the largest angle within half a step of each node [rad]
    excess: float  # [m] the largest excess over a tolerance, as for `OnPath.violation`
    note: str  # a message about the largest errors


def path_errors(problem: Problem, rates: FloatArray) -> PathErrors:
    """Return the errors of a motion along a problem's path, with joint rates (N + 1, n) at the nodes."""
    path: Path = problem.goal
    steps = len(rates) - 1
    nodes, fine = np.arange(steps + 1), np.arange(_FINER * steps + 1) / _FINER
    finer = np.stack([np.interp(fine, nodes, column) for column in rates.T], axis=1)
    motion = problem.motion(finer, problem.dt / _FINER)
    places = path.places(motion.times)
    missed = places.pose_error(Variables(motion).frame("tip", places.on))
    every = 2 * _FINER
    errors = np.stack([missed.distance[0], missed.angle[0]])
    # The neighbourhood of a node extends half a step to both sides.
    begins = np.maximum(every * nodes - _FINER, 0)
    largest = np.maximum.reduceat(errors, begins, axis=1)
    share = max(float(errors[0].max()) / path.tolerance, float(errors[1].max()) / path.orientation_tolerance)
    note = f"between nodes the end effector is up to {missed.text()} off the path"
    return PathErrors(largest[0], largest[1], max(share - 1.0, 0.0) * path.tolerance, note)
