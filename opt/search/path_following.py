"""Motions along a path: a rollout by resolved rates, then an optimisation of the redundant motion.

A rollout follows the path node by node, with a reacting base. The desired velocity of the end effector is the
velocity of the path plus a feedback of the error. The redundant motion is close to a preferred motion. The
preferred motion results from a descent of the terms and limits of the whole motion (`gauss_newton`). The
descent follows the path only approximately, so another rollout then corrects the end effector.

Reference: Y. Umetani, K. Yoshida, "Resolved motion rate control of space manipulators with generalized
Jacobian matrix", IEEE Transactions on Robotics and Automation 5 (1989).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import daqp
import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue, length_text
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.derivatives import Variables
from ffsms_pin.opt.goals.curves import TimeLaw
from ffsms_pin.opt.goals.path import Path
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.rollouts import Rollouts, configurations
from ffsms_pin.opt.search.control_qp import ControlQP
from ffsms_pin.opt.search.diagnosis import joint_limits_used, noted
from ffsms_pin.opt.search.gauss_newton import LAST_WEIGHTS, Model, descend, linearise
from ffsms_pin.opt.search.inverse_kinematics import reach_range
from ffsms_pin.opt.search.spline import Grid, rate_spline
from ffsms_pin.opt.search.time_law import check_bounded, check_timing, fastest_law, limit_rows
from ffsms_pin.opt.step.state import rate_bounds
from ffsms_pin.opt.trajectory import Trajectory, measure
from ffsms_pin.robot.base_motion import advance

if TYPE_CHECKING:
    from ffsms_pin.opt.search.search import SearchOptions

_GAIN = 5.0  # [1/s] feedback gain of errors
_LEVER = 0.3  # [m] lever arm by which angular velocities are multiplied to compare them with velocities
_DAMPING = 1e-7  # weight of the distance to the preferred rates, relative to |J|^2, for singular postures
_RETURN = 2.0  # [1/s] gain by which redundant motion returns to the preferred motion


class PathNodes(NamedTuple):
    """The poses and twists of a path at the nodes of a motion, in inertial or base axes (`on_base`)."""

    positions: FloatArray  # (N + 1, 3) [m]
    velocities: FloatArray  # (N + 1, 3) [m/s]
    rotations: FloatArray | None  # (N + 1, 3, 3)
    angular_velocities: FloatArray | None  # (N + 1, 3) [rad/s]
    free_axis: FloatArray | None  # (3,) in the axes of the end effector
    on_base: bool

    @classmethod
    def of(cls, path: Path, times: FloatArray) -> PathNodes:
        """Evaluate a path at times (N + 1,) of the motion [s]."""
        place, velocities, angular_velocities = path.motion(times)
        rotations = (
            None if place.rotation is None else np.ascontiguousarray(np.moveaxis(place.rotation, -1, 0))
        )
        angular_velocities = (
            None if angular_velocities is None else np.ascontiguousarray(angular_velocities.T)
        )
        return cls(
            np.ascontiguousarray(place.position.T),
            np.ascontiguousarray(velocities.T),
            rotations,
            angular_velocities,
            path.free_axis,
            place.moves_with_base,
        )


def feedback_gain(dt: float, gain: float = _GAIN) -> float:
    """Return the feedback gain of path errors [1/s], at most 0.3 / dt to avoid overshoot."""
    return min(gain, 0.3 / dt)


class Task(NamedTuple):
    """A desired end-effector velocity at one instant: J u = velocity for the joint rates u.

    Angular rows are multiplied by a lever arm of 0.3 m.
    """

    J: FloatArray  # (m, n)
    velocity: FloatArray  # (m,) [m/s]


def path_task(
    problem: Problem, nodes: PathNodes, k: int, q: FloatArray, joints: FloatArray, gain: float
) -> Task:
    """Return the task at node k in a configuration q (nq,): the path's velocity plus `gain` times the error.

    `joints` (n,) are the joint positions of q. The velocity due to a momentum is subtracted.
    """
    columns, _, more = kernel.step_state(problem.stack.tree, q[:7], joints, problem.momentum)
    tip, drift, rotation = more[:3], more[12:18], more[18:27].reshape(3, 3)
    J, position, velocity = columns[1], nodes.positions[k], nodes.velocities[k]
    angular_velocity = None if nodes.angular_velocities is None else nodes.angular_velocities[k]
    desired = None if nodes.rotations is None else nodes.rotations[k]
    if nodes.on_base:  # the path moves with the base
        J, drift = columns[2], np.zeros(6)
        base = pin.Quaternion(q[3:7]).toRotationMatrix()
        position, velocity = q[:3] + base @ position, base @ velocity
        angular_velocity = None if angular_velocity is None else base @ angular_velocity
        desired = None if desired is None else base @ desired
    linear = velocity - drift[:3] + gain * (position - tip)
    if desired is None or angular_velocity is None:
        return Task(J[:3], linear)
    turning = J[3:]
    if nodes.free_axis is None:
        angular = angular_velocity - drift[3:] + gain * pin.log3(desired @ rotation.T)
    else:
        axis, now = desired @ nodes.free_axis, rotation @ nodes.free_axis
        across = np.eye(3) - np.outer(now, now)
        angular = across @ (angular_velocity - drift[3:]) + gain * _alignment(now, axis)
        turning = across @ turning
    return Task(np.vstack([J[:3], _LEVER * turning]), np.concatenate([linear, _LEVER * angular]))


def _alignment(now: FloatArray, axis: FloatArray) -> FloatArray:
    """Return the rotation vector (3,) from the unit vector `now` to the unit vector `axis`."""
    across = np.cross(now, axis)
    sine = float(np.linalg.norm(across))
    return np.asarray(across * (np.arctan2(sine, float(now @ axis)) / max(sine, 1e-12)))


def resolved(
    task: Task, prefer: FloatArray, bounds: tuple[FloatArray, FloatArray], weight: FloatArray | None = None
) -> FloatArray:
    """Return joint rates (n,) for a task within bounds; redundant motion is nearest to the rates `prefer`.

    `weight` (n, n) is the metric of the distance to `prefer`; default: the identity.
    """
    J, least, greatest = task.J, *bounds
    W = np.eye(len(prefer)) if weight is None else weight
    scale = _DAMPING * float(np.sum(J * J))
    H = J.T @ J + scale * W
    g = J.T @ (task.velocity - J @ prefer)
    rates = prefer + np.linalg.solve(H, g)
    if (rates <= greatest).all() and (rates >= least).all():
        return np.asarray(rates)
    n = len(prefer)
    size = np.trace(H) / n
    x, _, status, _ = daqp.solve(
        H / size, -g / size, np.empty((0, n)), greatest - prefer, least - prefer, np.zeros(n, dtype=np.int32)
    )
    rates = prefer + x if status == 1 and np.isfinite(x).all() else rates
    return np.clip(rates, least, greatest)


@dataclass(frozen=True, eq=False)
class Preference:
    """A preferred joint motion for the redundant part of a rollout: rates and positions at the nodes."""

    rates: FloatArray  # (N + 1, n)
    joints: FloatArray  # (N + 1, n)

    def at(self, k: int, joints: FloatArray) -> FloatArray:
        """Return the preferred joint rates (n,) at node k and joint positions (n,)."""
        return np.asarray(self.rates[k] + _RETURN * (self.joints[k] - joints))


def rollout_along(
    problem: Problem,
    nodes: PathNodes,
    prefer: Preference | None = None,
    bounded: bool = True,
    begin: FloatArray | None = None,
) -> FloatArray:
    """Return joint rates (N + 1, n) at the nodes along a path.

    If `bounded` is true and the problem has joint limits, the motion satisfies these limits. The rates at the
    first node are `begin` (n,), by default `Problem.joint_rates`. Without a preference the rates have the
    least norm, except that joints near a position limit move away from the limit.
    """
    sms, dt, steps, n = problem.sms, problem.dt, problem.steps, problem.sms.n
    bounded = bounded and any(limit.joint_bounds is not None for limit in problem.limits)
    fixed = ~problem.free
    unbounded: tuple[FloatArray, FloatArray] = np.full(n, -1e9), np.full(n, 1e9)
    gain, weight = feedback_gain(dt), _locked_weight(problem)
    middle = _Middle.of(sms.limits.lower, sms.limits.upper)
    rates = np.empty((steps + 1, n))
    q, joints, slope = problem.q0, problem.joints0.copy(), np.zeros(n)
    rates[0] = problem.joint_rates if begin is None else begin
    for k in range(steps):
        ahead, _ = advance(sms, q, rates[k], slope, dt, problem.momentum, problem.mode)
        there = joints + dt * (rates[k] + 0.5 * dt * slope)
        task = path_task(problem, nodes, k + 1, ahead, there, gain)
        lower, upper = rate_bounds(joints, rates[k], sms.limits, dt) if bounded else unbounded
        preferred = middle.rates(there) if prefer is None else prefer.at(k + 1, there)
        if fixed.any():
            preferred = np.where(fixed, 0.0, preferred)
        rates[k + 1] = resolved(task, preferred, (lower, upper), weight)
        if fixed.any():
            rates[k + 1][fixed] = 0.0
        slope = (rates[k + 1] - rates[k]) / dt
        q, _ = advance(sms, q, rates[k], slope, dt, problem.momentum, problem.mode)
        joints = joints + 0.5 * dt * (rates[k] + rates[k + 1])
    return rates


def _locked_weight(problem: Problem) -> FloatArray | None:
    """Return a metric (n, n) for `resolved` in which locked joints hardly move; None if all are free."""
    return None if problem.free.all() else np.diag(np.where(problem.free, 1.0, 1e12))


class _Middle(NamedTuple):
    """A preference for joint rates towards the middle of the joints' ranges."""

    middle: FloatArray  # (n,)
    half: FloatArray  # (n,) half of the range; infinite without limits

    @classmethod
    def of(cls, lower: FloatArray, upper: FloatArray) -> _Middle:
        """Return the preference for ranges from lower (n,) to upper (n,)."""
        ends = np.isfinite(upper - lower)
        middle = np.where(ends, 0.5 * (lower + upper), 0.0)
        return cls(middle, np.where(ends, 0.5 * (upper - lower), np.inf))

    def rates(self, joints: FloatArray) -> FloatArray:
        """Return rates (n,) towards the middle for joints beyond 70 % of their half ranges, else zero."""
        off = joints - self.middle
        over = np.maximum(np.abs(off) - 0.7 * self.half, 0.0)
        return np.asarray(-np.sign(off) * over)


_GRID = Grid(16, 3, 3)  # grid of the spline that changes redundant motion
# A descent of a motion with more than `_STEPS` time steps uses `_STEPS` steps, or more steps if these would
# be longer than `_STEP` [s].
_STEPS, _STEP = 500, 0.05
_ROUNDS = 3  # rounds of a descent and a rollout
_ITERATIONS = 4  # iterations of a descent


class Followed(NamedTuple):
    """The joint rates (N + 1, n) of a rollout along a path, and its plan."""

    rates: FloatArray
    plan: Trajectory

    def worth(self) -> tuple[bool, float]:
        """Return the sort key of the plan: (True, sum of violations), or (False, cost) without violations."""
        broken = sum(self.plan.broken.values())
        return (True, broken) if broken > 0.0 else (False, sum(self.plan.shares.values()))


def follow_path(
    problem: Problem, options: SearchOptions | None = None, progress: Callable[[float], None] | None = None
) -> Trajectory:
    """Plan a motion along the path of a problem by a rollout, and for redundant arms by descents.

    The option `time_limit` ends the descents, and `without=["descent"]` omits them. Other options raise
    `InvalidValue`, because they are for searches. For a path with `timing="fastest"` see
    `follow_fastest`.
    """
    path = problem.goal
    assert isinstance(path, Path)
    if options is not None:
        _check_options(options)
    check_begin(problem, path)
    if path.timing == "fastest":
        return follow_fastest(problem, options, progress)
    return plan_along(problem, options, progress)


def _check_options(options: SearchOptions) -> None:
    """Raise `InvalidValue` for options of searches that paths do not support."""
    for name in options.without:
        if name != "descent":
            raise InvalidValue("without", name, 'may contain only "descent" for an opt.Path')
    if options.cost_tolerance != type(options).cost_tolerance:
        remedy = (
            "is not used for an opt.Path, along which no search compares the costs of plans; leave it out"
        )
        raise InvalidValue("cost_tolerance", options.cost_tolerance, remedy)


def plan_along(
    problem: Problem, options: SearchOptions | None = None, progress: Callable[[float], None] | None = None
) -> Trajectory:
    """Plan along a path whose time law is fixed, by a rollout and descents of redundant motion."""
    nodes = PathNodes.of(problem.goal, problem.nodes)
    descends = is_redundant(problem, nodes) and not (options is not None and "descent" in options.without)
    prefer = redundant_motion(problem, options, progress) if descends else None
    rates = rollout_along(problem, nodes, prefer)
    plan = measure(problem, rates)
    if not plan.reached:
        plan = explain_path(problem, nodes, plan)
    if progress is not None:
        progress(1.0)
    return noted(plan, plan.note, rest_note(problem.goal))


def rest_note(path: Path) -> str:
    """Return a message if the motion ends before the last sample of its path."""
    if path.rest <= 1e-9:
        return ""
    return f"the motion ends {path.rest:.3g} s before the last sample of the path, which is not reached"


def redundant_motion(
    problem: Problem, options: SearchOptions | None, progress: Callable[[float], None] | None
) -> Preference | None:
    """Return a preferred motion that improves the rollout (`Followed.worth`); None if none is found.

    For motions with many time steps the descent uses fewer, larger steps.
    """
    begun, limit = time.perf_counter(), math.inf
    if options is not None and options.time_limit is not None:
        limit = options.time_limit
    steps = max(_STEPS, math.ceil(problem.duration / _STEP))
    coarse = replace(problem, dt=problem.duration / steps) if problem.steps > steps else problem
    nodes = PathNodes.of(coarse.goal, coarse.nodes)
    rates = rollout_along(coarse, nodes)
    best, preferred = Followed(rates, measure(coarse, rates)), None
    for i in range(_ROUNDS):
        if progress is not None:
            progress((i + 1.0) / (_ROUNDS + 2.0))
        if time.perf_counter() - begun > limit or (prefer := improved(coarse, best.rates)) is None:
            break
        rates = rollout_along(coarse, nodes, prefer)
        other = Followed(rates, measure(coarse, rates))
        before, after = best.worth(), other.worth()
        if after >= before:
            break
        best, preferred = other, prefer
        if before[0] == after[0] and after[1] > 0.8 * before[1]:
            break
    if preferred is None or coarse is problem:
        return preferred
    finer = [np.interp(problem.nodes, coarse.nodes, column) for column in preferred.rates.T]
    return preference(problem, np.stack(finer, axis=1))


_LAW_NODES = 600  # number of intervals of a path, at whose ends the time law satisfies the limits
_MARGINS = (0.01, 0.03, 0.1)  # safety margins of the limits, tried in order


def follow_fastest(
    problem: Problem, options: SearchOptions | None = None, progress: Callable[[float], None] | None = None
) -> Trajectory:
    """Plan the motion of least time along a geometric path, within the duration of the problem.

    The joint path does not depend on the speed, so a rollout at constant speed computes it. Then
    `fastest_law` computes the time of each point of the path under the speed bounds of the limits. If the
    least time exceeds the duration, the path is planned in the given duration, with a note.
    """
    path = problem.goal
    assert isinstance(path, Path)
    check_timing(problem)
    at_constant_speed = replace(problem, goal=replace(path, timing="given"))
    motion = _joint_path(problem, path)
    if motion is None:
        return plan_along(at_constant_speed, options, progress)
    bounds = [bound for limit in problem.limits if (bound := limit.speed_bound(motion)) is not None]
    check_bounded(problem, bounds)
    best: Trajectory | None = None
    for margin in _MARGINS:
        law = fastest_law(limit_rows(motion.times, bounds, margin))
        if law is None:
            break
        duration = path.approach_time + float(law.times[-1])
        if duration > problem.duration * (1.0 + 1e-9):
            plan = plan_along(at_constant_speed, options, progress)
            note = f"with the fastest time law that was found for the path, {duration:.2f} s would suffice"
            return noted(plan, plan.note, note, shortest_duration=duration)
        steps = max(round(duration / problem.dt), 1)
        timed = replace(path, law=law)
        faster = replace(problem, goal=timed, duration=duration, dt=duration / steps)
        plan = measure(faster, rollout_along(faster, PathNodes.of(faster.goal, faster.nodes)))
        if plan.reached:
            return noted(plan, plan.note, shortest_duration=plan.duration)
        best = best or plan
    return best or plan_along(at_constant_speed, options, progress)


def _joint_path(problem: Problem, path: Path) -> Rollouts | None:
    """Return the motion along a path in 1 s without joint limits.

    The result is None if an error exceeds half of the path's tolerance.
    """
    start = problem
    if path.approach_time > 0.0:  # the joint path begins in the final posture of the approach
        rest = np.zeros(2)
        still = replace(path, law=TimeLaw(np.array([0.0, 1.0]), rest, rest))
        approach = replace(problem, goal=still, duration=path.approach_time + problem.dt)
        motion = approach.motion(rollout_along(approach, PathNodes.of(approach.goal, approach.nodes)))
        q = configurations(problem.sms, problem.q0, motion)[-1]
        start = replace(problem, q0=q, goal=replace(path, approach_time=0.0, duration=None, begin=None))
    even = TimeLaw(np.array([0.0, 1.0]), np.array([0.0, 1.0]), np.ones(2))
    unit = replace(start, goal=replace(start.goal, law=even), duration=1.0, dt=1.0 / _LAW_NODES)
    nodes = PathNodes.of(unit.goal, unit.nodes)
    task = path_task(unit, nodes, 0, unit.q0, unit.joints0, 0.0)
    unbounded = np.full(problem.sms.n, 1e9)
    begin = resolved(task, np.zeros(problem.sms.n), (-unbounded, unbounded), _locked_weight(problem))
    slopes = rollout_along(unit, nodes, bounded=False, begin=begin)
    motion = unit.motion(slopes)
    error = unit.goal.places(motion.times).pose_error(Variables(motion).frame("tip", path.on))
    if error.distance.max() > 0.5 * path.tolerance or error.angle.max() > 0.5 * path.orientation_tolerance:
        return None
    return motion.at(None, slice(None, None, 2))


def is_redundant(problem: Problem, nodes: PathNodes) -> bool:
    """Return whether the joints that are not locked are redundant for a path at the motion's start."""
    task = path_task(problem, nodes, 0, problem.q0, problem.joints0, _GAIN)
    sizes = np.linalg.svd(task.J[:, problem.free], compute_uv=False)
    return int(problem.free.sum()) > int((sizes > 1e-6 * sizes.max(initial=0.0)).sum())


def check_begin(problem: Problem, path: Path) -> None:
    """Raise `InvalidValue` if a path without an approach does not begin at the end effector."""
    place = path.place(0.0)
    pose = problem.sms.at(problem.q0).end_effector_pose
    distance, angle = place.error(pose, problem.q0)
    if distance <= path.tolerance and angle <= path.orientation_tolerance:
        return
    error = length_text(distance) + (f" and {np.degrees(angle):.3g} deg" if path.turned else "")
    remedy = (
        f"must leave time [s] to move to the path, which begins {error} from the end effector; "
        f"set opt.Path(..., approach_time={max(2.0, np.ceil(10.0 * distance)):g}), or another start"
    )
    raise InvalidValue("approach_time", path.approach_time, remedy)


def improved(problem: Problem, rates: FloatArray) -> Preference | None:
    """Return a joint motion near rates (N + 1, n) with a smaller merit; None if no such motion is found."""
    whole = rate_spline(problem.steps, problem.dt, _GRID, free_end=True)
    spline = whole.around(problem.dt, rates)
    model = Model(problem, problem.goal, spline, ControlQP(problem, spline))
    start = linearise(model, np.zeros((1, spline.size, problem.sms.n)), LAST_WEIGHTS, 1e-4)
    merit = float(start.merit[0])
    motion = descend(start, LAST_WEIGHTS, _ITERATIONS)
    if not motion.merit[0] < merit:
        return None
    changed = rates + whole.rates_at(problem.nodes).free[:, 1:] @ motion.p[0]
    return preference(problem, changed)


def preference(problem: Problem, rates: FloatArray) -> Preference:
    """Return the preference for joint rates (N + 1, n) at the nodes of a problem."""
    travel = np.cumsum(0.5 * problem.dt * (rates[1:] + rates[:-1]), axis=0)
    return Preference(rates, problem.joints0 + np.vstack([np.zeros(problem.sms.n), travel]))


def explain_path(problem: Problem, nodes: PathNodes, plan: Trajectory) -> Trajectory:
    """Return a failed plan along a path with a note of its causes, and a sufficient duration if known."""
    path = problem.goal
    assert isinstance(path, Path)
    reasons, shortest = list[str](), 0.0
    leaves = bool((_used(problem, plan) > 1.0).any())
    out_of_reach = _out_of_reach(problem, nodes) if leaves else ""
    begins_fast = path.approach_time == 0.0 and _begin_speed(problem, nodes) > 1e-3
    if out_of_reach:
        reasons.append(out_of_reach)
    elif leaves:
        reasons.append(_binding(problem, plan))
    if leaves and begins_fast:
        reasons.append(
            f"the path's velocity differs by {1e3 * _begin_speed(problem, nodes):.3g} mm/s from the end "
            "effector's velocity at the start; set opt.Path(..., approach_time=2.0), or a path that "
            "starts at rest"
        )
    elif not out_of_reach:
        shortest = _sufficient_duration(problem, nodes)
        slower = "" if path.geometric else ", if the curve is slowed down to this duration,"
        sufficient = f"a duration of {shortest:.2f} s{slower} would suffice"
        reasons.append(sufficient if shortest else "no sufficient duration is known")
    return noted(plan, plan.note, *reasons, shortest_duration=shortest)


def _out_of_reach(problem: Problem, nodes: PathNodes) -> str:
    """Return a message on the first point of a path outside the workspace; empty if no point is outside."""
    if nodes.on_base:
        return ""
    least, most = reach_range(problem)
    t = problem.nodes
    distances = np.linalg.norm(nodes.positions - problem.com0 - t[:, None] * problem.drift, axis=1)
    outside = np.flatnonzero((distances > most) | (distances < least))
    if not outside.size:
        return ""
    k = int(outside[0])
    return (
        f"binding: the workspace, because the path is {distances[k]:.3f} m from the {problem.centre} "
        f"at {t[k]:.3g} s, {_share_of_path(problem, t[k])}, and the end effector can be {least:.3f} to "
        f"{most:.3f} m from it"
    )


def _share_of_path(problem: Problem, t: float) -> str:
    """Describe the time `t` of the motion [s] as a share of the path's time."""
    approach = problem.goal.approach_time
    if t < approach:
        return "during the approach"
    return f"{100.0 * (t - approach) / (problem.duration - approach):.0f} % of the path's time"


def _used(problem: Problem, plan: Trajectory) -> FloatArray:
    """Return the larger error of a plan near each node (N + 1,), as a share of the path's tolerance."""
    path = problem.goal
    used = np.fmax(plan.path_error / path.tolerance, plan.path_angle_error / path.orientation_tolerance)
    return np.asarray(used)


def _binding(problem: Problem, plan: Trajectory) -> str:
    """Describe the point at which a plan leaves its path, and the joint limits active shortly before it."""
    k = int(np.argmax(_used(problem, plan) > 1.0))
    t = plan.t[k]
    where = f"at {t:.3g} s, {_share_of_path(problem, t)}"
    first = max(0, k - max(2, round(0.5 / problem.dt)))
    names = problem.sms.joint_names
    used = joint_limits_used(problem, plan, slice(first, k + 1))
    binding = [f"the {kind} limit of '{names[i]}'" for kind, i in used]
    if not binding:
        return (
            f"the end effector leaves the path {where}: no joint limit is active, the posture may be singular"
        )
    return f"the end effector leaves the path {where}; binding: {', '.join(binding[:3])}"


def _begin_speed(problem: Problem, nodes: PathNodes) -> float:
    """Return the difference [m/s] between the velocities of path and end effector at the start."""
    task = path_task(problem, nodes, 0, problem.q0, problem.joints0, 0.0)
    return float(np.linalg.norm((task.velocity - task.J @ problem.joint_rates)[:3]))


_SLOWEST = 20.0  # largest factor on a duration; a larger factor indicates a singular posture near the path
_TRIALS = 3  # number of trials to shorten a sufficient duration
_SPARE = 1.02  # safety factor on the result of `slowing`


def _sufficient_duration(problem: Problem, nodes: PathNodes) -> float:
    """Return a duration [s] in which the path is followed within all limits; zero if it is unknown.

    Without momentum the joint path of a path in inertial or base axes does not depend on the speed. Joint
    rates are proportional to the speed, accelerations and torques to its square.
    """
    path = problem.goal
    if problem.momentum is not None or problem.joint_rates.any() or not isinstance(path.frame, str):
        return 0.0
    free = rollout_along(problem, nodes, bounded=False)
    scale = _SPARE * slowing(problem, free)
    if not np.isfinite(scale) or not 1.0 < scale <= _SLOWEST:
        return 0.0
    if not _follows_slowed(problem, scale):
        return 0.0
    failed, enough = 1.0, scale
    for _ in range(_TRIALS):
        middle = math.sqrt(failed * enough)
        if _follows_slowed(problem, middle):
            enough = middle
        else:
            failed = middle
    return enough * problem.duration


def _follows_slowed(problem: Problem, scale: float) -> bool:
    """Return whether a rollout follows the path of a problem in `scale` times its duration."""
    path = problem.goal
    duration = scale * problem.duration
    steps = min(round(duration / problem.dt), max(problem.steps, 2000))
    slower = replace(problem, goal=path.slower(scale), duration=duration, dt=duration / steps)
    nodes = PathNodes.of(slower.goal, slower.nodes)
    return measure(slower, rollout_along(slower, nodes)).reached


def slowing(problem: Problem, rates: FloatArray) -> float:
    """Return the least factor on the duration with which joint rates (N + 1, n) satisfy the joint limits.

    These are the limits of joint rates, accelerations and torques.
    """
    limits = problem.sms.limits
    velocity = float((np.abs(rates) / limits.velocity).max())
    acceleration = float((np.abs(np.diff(rates, axis=0) / problem.dt) / limits.acceleration).max())
    motion = problem.motion(rates)
    torques = np.maximum(np.abs(motion.forces[:-6, 0, ::2]), np.abs(motion.before.forces[:-6, 0]))
    torque = float((torques.T / limits.torque).max())
    return max(velocity, math.sqrt(acceleration), math.sqrt(torque))
