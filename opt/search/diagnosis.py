"""The diagnosis of a failed plan: its causes, and a duration that would be sufficient."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.evaluation import Violation, violation_of
from ffsms_pin.opt.limits.limit import Limit
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.rollouts import ARRIVAL_SHARE
from ffsms_pin.opt.search.gauss_newton import LAST_WEIGHTS, Model, linearise
from ffsms_pin.opt.search.inverse_kinematics import (
    JointGoals,
    at_rest,
    moves_to,
    pose_error_at,
    reach_range,
    straight_time,
    within_workspace,
    workspace_distances,
)
from ffsms_pin.opt.search.spline import FINE
from ffsms_pin.opt.trajectory import Trajectory, measure

Kinds: TypeAlias = list[tuple[str, int]]  # kinds of joint limits, with indices of joints
Attempt: TypeAlias = Callable[[Problem, FloatArray], bool]  # a check of another duration, see `explain`
_LONGER = (1.25, 1.5, 2.0, 3.0)  # factors on the failed duration


def with_limit_notes(
    problem: Problem, plan: Trajectory, again: Callable[[Problem], Trajectory]
) -> Trajectory:
    """Return a failed plan with notes on its active limits; `again(problem)` plans another problem."""
    motion, notes = problem.motion(plan.joint_rates), [plan.note]
    for limit in (limit for limit in problem.limits if limit.name in plan.binding):
        nearest = violation_of(limit, motion).nearest
        if nearest:
            notes.append(f"blocked by {nearest}")
        elif limit.eased_by_time and limit.name not in plan.broken:
            # The plan satisfies the limit, so only a motion without the limit shows why the limit is active.
            others = [_Nothing(other.name) if other is limit else other for other in problem.limits]
            free = again(replace(problem, limits=others))
            note = violation_of(limit, problem.motion(free.joint_rates)).note if free.reached else ""
            if note:
                notes.append(f"without the limit '{limit.name}' a motion arrives, but {note}")
    return noted(plan, *notes)


class _Nothing(Limit):
    """A limit without conditions, which replaces the limit with the same name."""

    def __init__(self, name: str) -> None:
        self.name = name

    def rows(self, step: Any) -> None:
        return None

    def residual(self, m: Any) -> list[Any]:
        return []

    def violation(self, motion: Any) -> Violation:
        return Violation()


def refused(problem: Problem) -> Trajectory | None:
    """Return a plan at rest if the start violates a limit with `Limit.refusal`, otherwise None.

    Raise `InvalidValue` if the start overlaps an obstacle, or if the target is inside an obstacle.
    """
    still = np.zeros((problem.steps + 1, problem.sms.n))
    begin = problem.motion(still[:2])
    violations = [(limit, violation_of(limit, begin)) for limit in problem.limits if limit.refusal]
    for _, violation in violations:
        if violation.overlap:
            overlap = violation.overlap
            text = f"must keep clear of obstacles: {overlap} at the start; move the start or the obstacle"
            raise InvalidValue("q0", problem.joints0.round(6), text, overlap)
    place = problem.place
    for obstacle in (obstacle for limit in problem.limits for obstacle in limit.obstacles):
        if obstacle.on_base or place.moves_with_base or obstacle.grasp is not None:
            continue  # the base's final pose is unknown, and a grasp may be inside the client's body
        depth = -obstacle.distance(place.position, problem.time_offset + problem.duration)
        if depth > problem.goal.tolerance:
            remedy = f"it is {1e3 * depth:.1f} mm inside '{obstacle.name}'; move the target or the obstacle"
            raise InvalidValue("target", place.position, f"must lie outside obstacles: {remedy}")
    notes = [
        limit.refusal.format(note=violation.note) for limit, violation in violations if violation.amount > 0.0
    ]
    return noted(measure(problem, still), *notes, clear=False) if notes else None


def explain(
    problem: Problem,
    plan: Trajectory,
    goals: JointGoals,
    binding: Kinds,
    attempt: Attempt,
) -> Trajectory:
    """Return a failed plan with a note of its error, the active limits, and a sufficient duration.

    `goals` are the joint goals of the search, and `binding` has (kind, joint) of the active joint limits.
    `attempt(problem, joints)` is called with problems of longer durations. It returns whether straight moves
    to joint goals near `joints` (K, n) solve a problem, or if K is 0 whether a quick search solves it.
    """
    why = reasons(problem, plan, binding, goals)
    if arrives_while_tumbling(problem, plan):
        # Limits that are active during the motion are not the reason, and a longer duration does not reduce
        # the robot's rotation rate.
        return noted(plan, plan.note, _cannot_stay(problem, plan))
    if plan.reached:  # the plan only misses the tolerance, so no other duration is tried
        return noted(plan, plan.note, *why)
    at = "({:.4f}, {:.4f}, {:.4f})".format(*plan.end_effector[-1])
    ends = f"ends {plan.position_error[-1]:.4f} m from the target, at {at}, the nearest position found"
    if (turned := plan.orientation_error[-1]) > 0.0:
        ends += f", rotated by {turned:.4f} rad from the desired attitude"
    if not within_workspace(problem):
        return noted(plan, ends, plan.note, *why)
    if problem.goal.exact:
        t, inside = _within_reach(problem)
        hopeless = problem.goal.moves and _too_fast(problem, goals)
        later = [] if hopeless else [factor * problem.duration for factor in (1.5, 2.0)]
        later = [deadline for deadline in later if inside[int(np.argmin(np.abs(t - deadline)))]]
        none = goals.joints[:0]
        shortest = next((deadline for deadline in later if attempt(problem.lasting(deadline), none)), 0.0)
    else:
        slow = any(kind in ("rate", "acceleration") for kind, _ in binding)
        slow = slow or any(limit.eased_by_time and limit.name in plan.binding for limit in problem.limits)
        shortest = _sufficient(problem, goals, slow, attempt)
    known = f"a duration of {shortest:.2f} s would suffice" if shortest else "no sufficient duration is known"
    return noted(plan, ends, plan.note, *why, known, shortest_duration=shortest)


def reasons(problem: Problem, plan: Trajectory, binding: Kinds, goals: JointGoals | None = None) -> list[str]:
    """Return the reasons why a plan misses its goal, such as active limits; for arguments see `explain`."""
    if not within_workspace(problem):
        distance, least, most = workspace_distances(problem)
        outside = (
            f"binding: the workspace, because the end effector can be {least:.3f} to {most:.3f} m from the "
            f"{problem.centre} and the target is {distance:.3f} m from it"
        )
        return [outside, _time_within_reach(problem) if problem.goal.moves else ""]
    fast = _too_fast(problem, goals) if goals is not None and problem.goal.moves else ""
    others = [
        limit.name for limit in problem.limits if limit.name in plan.binding and limit.joint_bounds is None
    ]
    joints = [f"{kind} limit of '{problem.sms.joint_names[i]}'" for kind, i in binding[:3]]
    causes = [fast, *(f"binding: {', '.join(names)}" for names in (others, joints) if names)]
    if any(causes):
        return causes
    # A radian is weighted like a metre.
    error = max(plan.position_error[-1], *plan.orientation_error[-1:])
    far = not error <= 0.05 * problem.stack.length
    if goals is not None and len(goals.joints) and not len(goals.near(problem)) and far:
        return ["binding: probably the workspace, because no posture that was tried is near the goal"]
    return ["no limit is active; no motion was found that ends nearer to the goal"]


def arrives_while_tumbling(problem: Problem, plan: Trajectory) -> bool:
    """Return whether a tumbling robot is at the goal at the deadline, but not in the whole last tenth."""
    return problem.tumbles and plan.within_tolerance and not (plan.reached or plan.broken)


def _cannot_stay(problem: Problem, plan: Trajectory) -> str:
    """Describe the joint rates with which a tumbling robot would stay at the goal during the last tenth."""
    from scipy.optimize import linprog  # slow to load

    sms, largest, drift = problem.sms, 0.0, 0.0
    late = np.flatnonzero(plan.t >= ARRIVAL_SHARE * plan.duration - 1e-9)
    for k in late[np.linspace(0, len(late) - 1, min(5, len(late))).astype(int)]:
        state = sms.at(plan.q[k], plan.v[k])
        rows = slice(None) if problem.place.rotation is not None else slice(3)
        J = state.J_star[rows] * problem.free
        resting = state.end_effector_twist[rows] - J @ plan.v[k, 6:]
        drift = max(drift, float(np.linalg.norm(resting[:3])))
        # The least share x of the rate limits for which joint rates u hold the end effector: J u = -resting,
        # where `resting` is the end effector's twist with the joints at rest.
        n, limit = sms.n, np.minimum(sms.limits.velocity, 1e6)
        bounds = np.block([[np.eye(n), -limit[:, None]], [-np.eye(n), -limit[:, None]]])
        columns = np.hstack([J, np.zeros((len(J), 1))])
        solution = linprog(
            np.append(np.zeros(n), 1.0), bounds, np.zeros(2 * n), columns, -resting, [(None, None)] * (n + 1)
        )
        largest = max(largest, float(solution.fun)) if solution.status == 0 else np.inf
    needed = "no joint rates hold the end effector"
    if np.isfinite(largest):
        needed = f"holding the end effector takes {largest:.2g} times the joints' rate limits"
    return (
        "the end effector is at the target at the deadline, but no motion was found that stays there; "
        f"with joints at rest the rotating robot carries the end effector off by {drift:.2g} m/s; in the "
        f"postures of this plan, {needed}"
    )


def moving_end_note(problem: Problem, plan: Trajectory) -> str:
    """Describe the joint rates that hold the end effector at the deadline while the base rotates.

    The text is empty if the joints are nearly at rest, the robot does not tumble, the goal has a velocity, or
    the plan fails.
    """
    rates = np.abs(plan.joint_rates[-1])
    holds = problem.tumbles and problem.place.rests and plan.reached
    if not holds or (rates <= 1.5 * at_rest(problem)).all():
        return ""
    share = float((rates / problem.sms.limits.velocity).max())
    return (
        f"the joints still move at the deadline, with up to {share:.0%} of their rate limits, to hold the "
        "end effector at the target while the base rotates"
    )


def joint_limits_used(problem: Problem, plan: Trajectory, nodes: slice = slice(None)) -> Kinds:
    """Return (kind, joint) of the joint limits active at `nodes` of a plan, the longest active first."""
    uses: list[tuple[int, str, int]] = []
    for bounds in (limit.joint_bounds for limit in problem.limits if limit.joint_bounds is not None):
        joints, whole = plan.joint_positions[nodes], bounds.upper - bounds.lower
        slack = np.minimum(joints - bounds.lower, bounds.upper - joints)
        kinds = {
            "rate": np.abs(plan.joint_rates[nodes]) >= 0.98 * bounds.velocity,
            "acceleration": np.abs(plan.joint_accelerations[nodes]) >= 0.98 * bounds.acceleration,
            "position": slack <= np.where(np.isfinite(whole), 0.01 * whole, 0.0),
        }
        uses += [(int(row.sum()), kind, i) for kind, used in kinds.items() for i, row in enumerate(used.T)]
    return [(kind, i) for count, kind, i in sorted(uses, key=lambda use: -use[0]) if count]


def noted(plan: Trajectory, *notes: str, **changes: Any) -> Trajectory:
    """Return a plan with the changed fields `changes`; its note joins the nonempty `notes` by semicolons."""
    return replace(plan, note="; ".join(filter(None, notes)), **changes)


def _sufficient(problem: Problem, goals: JointGoals, more_time_helps: bool, attempt: Attempt) -> float:
    """Return the first sufficient duration [s] of a few longer durations; 0 if none is sufficient.

    Without momentum the end pose of a joint path does not depend on the speed. So more time helps only if a
    limit that depends on the speed is active (`more_time_helps`), or if straight moves to the goal within the
    limits take more time. `opt.shortest` computes the least duration.
    """
    if problem.goal.moves:
        return 0.0  # a moving goal depends on the deadline
    there = goals.arrived(problem)
    there = there[keep_limits(Model.make(problem, FINE), there)]
    least = min((straight_time(problem, there) / ARRIVAL_SHARE).tolist(), default=0.0)
    if not more_time_helps and problem.momentum is None and least <= problem.duration:
        return 0.0
    longer = [factor * problem.duration for factor in _LONGER]
    if not len(there):
        longer = longer[-1:]  # a quick search takes long, so only the longest duration is tried
    elif least > longer[-1]:
        longer = [1.1 * least]
    tried = (duration for duration in longer if duration >= least)
    return next((duration for duration in tried if attempt(problem.lasting(duration), there)), 0.0)


def too_short(problem: Problem, goals: JointGoals) -> float:
    """Return a duration [s] below which a search is not expected to succeed; 0 if this is unknown."""
    if problem.momentum is not None or problem.joint_rates.any() or problem.goal.moves:
        return 0.0
    # In all known plans the motion takes at least 1 / 1.5 of the time of the fastest straight move.
    return min(straight_time(problem, goals.near(problem)).tolist(), default=0.0) / 1.5


def keep_limits(model: Model, goals: FloatArray) -> NDArray[np.bool_]:
    """Return the mask (K,) of moves to joint goals (K, n) that satisfy all limits except joint limits."""
    if not len(goals):
        return np.zeros(0, dtype=bool)
    problem, spline = model.problem, model.spline
    p = moves_to(problem, spline, goals)
    # `moves_to` shortens moves for which the duration is too short. Here they are scaled to full length,
    # except for joints that hardly move.
    displacements = goals - problem.joints0
    done = spline.position_points.of(p, problem.joint_rates)[:, -1]
    p *= np.divide(displacements, done, out=np.ones_like(displacements), where=np.abs(done) > 1e-6)[:, None]
    return np.asarray(linearise(model, p, LAST_WEIGHTS, below=-np.inf).limit_share <= 1.0)


def _time_within_reach(problem: Problem) -> str:
    """Describe the time interval, nearest to the deadline, in which a moving goal is within reach."""
    t, inside = _within_reach(problem)
    if not inside.any():
        return f"the goal is not within reach at any time in the next {t[-1]:.0f} s"
    k = int(np.flatnonzero(inside)[np.argmin(np.abs(t[inside] - problem.duration))])
    outside = np.flatnonzero(~inside)
    first = t[int(outside[outside < k].max(initial=-1)) + 1]
    last = t[int(outside[outside > k].min(initial=len(t))) - 1]
    remedy = f"set a deadline near {0.5 * (first + last):.1f} s"
    return f"the goal is within reach from {first:.1f} s to {last:.1f} s; {remedy}"


def _too_fast(problem: Problem, goals: JointGoals) -> str:
    """Return a message if matching the goal's twist at the deadline takes joint rates above their limits."""
    place, near = problem.place, goals.near(problem)
    if place.velocity is None or place.angular_velocity is None or not len(near):
        return ""
    base = place.base_attitude(problem.stack.evaluate(near.T).tip_rotation)
    J = pose_error_at(problem, place, problem.duration, near, base)[1]
    twist = np.concatenate([place.velocity - problem.drift, place.angular_velocity])
    rates = (np.linalg.pinv(J, rcond=1e-3) @ twist[:, None])[..., 0]
    share = float(np.abs(rates / problem.sms.limits.velocity).max(axis=1).min())
    if share <= 1.0:
        return ""
    return f"too fast: moving with the goal at the deadline takes {share:.1f} times the joints' rate limits"


def _within_reach(problem: Problem) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return future times (K,) [s], and the mask (K,) of times at which the goal is within reach."""
    least, most = reach_range(problem)
    t = np.linspace(0.0, max(10.0 * problem.duration, 600.0), 3001)[1:]
    displacement = problem.goal.places(t).position - problem.com0[:, None] - problem.drift[:, None] * t
    distance = np.linalg.norm(displacement, axis=0)
    return t, (distance >= least) & (distance <= most)
