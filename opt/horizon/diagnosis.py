"""Why a plan failed: the start, the workspace, the time, or what stood in the way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.horizon.descent import LAST_WEIGHTS, Model
from ffsms_pin.opt.horizon.meeting import later_deadline, time_within_reach, too_fast
from ffsms_pin.opt.horizon.options import SearchOptions
from ffsms_pin.opt.horizon.shooting import JointGoals, joint_range, spread_postures, straight_time, too_short
from ffsms_pin.opt.horizon.starts import moves_to
from ffsms_pin.opt.limits.limit import Limit, Violation
from ffsms_pin.opt.motion.features import Features
from ffsms_pin.opt.motion.motions import Motions
from ffsms_pin.opt.motion.rollout import rolled_out
from ffsms_pin.opt.parts.reading import violation_of
from ffsms_pin.opt.problem import ARRIVAL_SHARE, Problem
from ffsms_pin.opt.step.state import StepState
from ffsms_pin.opt.trajectory import Trajectory, measure

__all__ = ["explain", "keep_limits", "reach_range", "refused", "with_limits_said", "within_workspace"]

# Durations that are tried: a failed one and one that does come this near to each other, as a ratio.
_CLOSE = 1.08


def refused(problem: Problem) -> Trajectory | None:
    """A plan that stays where it is, where no motion from this start keeps the limits.

    Raises
    ------
    InvalidValue
        The start overlaps an obstacle, or the target lies inside one.
    """
    still = np.zeros((problem.steps + 1, problem.sms.n))
    q0, dt = problem.q0, problem.dt
    begin = rolled_out(problem.sms, problem.stack, q0, still[:2], dt, None, ARRIVAL_SHARE)
    found = [(limit, violation_of(limit, begin)) for limit in problem.limits if limit.refusal]
    for _, one in found:
        if one.overlap:
            raise InvalidValue(
                "q0",
                problem.joints0.round(6),
                f"must keep clear of obstacles: {one.overlap} at the start; move the start or the obstacle",
            )
    _check_target(problem)
    notes = [limit.refusal.format(note=one.note) for limit, one in found if one.amount > 0.0]
    if not notes:
        return None
    return replace(measure(problem, still), clear=False, note="; ".join(notes))


def _check_target(problem: Problem) -> None:
    """Raise where the target lies inside an obstacle at the deadline."""
    place = problem.goal.place(problem.duration)
    for began, obstacle in ((held.began, one) for held in problem.limits for one in held.obstacles):
        if obstacle.on_base or place.moves_with_base:
            continue  # where the base will be is not known
        depth = -obstacle.distance(place.position, began + problem.duration)
        if depth > problem.goal.tolerance:
            raise InvalidValue(
                "target",
                place.position,
                f"must lie outside obstacles: it is {1e3 * depth:.1f} mm inside '{obstacle.name}'; move "
                "the target or the obstacle",
            )


def with_limits_said(
    problem: Problem, plan: Trajectory, again: Callable[[Problem], Trajectory]
) -> Trajectory:
    """The failed plan; its note has what the limits that bind say of it.

    Parameters
    ----------
    problem : Problem
    plan : Trajectory
        That has not reached.
    again : callable
        Plans another problem, in a short search.
    """
    motion, said = problem.motion(plan.joint_rates), [plan.note]
    for limit in (one for one in problem.limits if one.name in plan.binding):
        nearest = violation_of(limit, motion).nearest
        if nearest:
            said.append(f"blocked by {nearest}")
        elif limit.eased_by_time and limit.name not in plan.broken:
            said.append(_held_back(problem, limit, again))
    return replace(plan, note="; ".join(filter(None, said)))


class _Nothing(Limit):
    """Asks for nothing, in the place of the limit of this name."""

    def __init__(self, name: str) -> None:
        self.name = name

    def rows(self, step: StepState) -> None:
        return None

    def residual(self, m: Features) -> list[Any]:
        return []

    def violation(self, motion: Motions) -> Violation:
        return Violation()


def _held_back(problem: Problem, limit: Limit, again: Callable[[Problem], Trajectory]) -> str:
    """What a limit lacks, where a motion that it does not hold back reaches; empty where none does.

    A planner that cannot have both ends within the limit and short of the goal. Then nothing is broken, and
    only such a motion tells what it takes.
    """
    free = again(
        replace(problem, limits=[_Nothing(one.name) if one is limit else one for one in problem.limits])
    )
    return violation_of(limit, problem.motion(free.joint_rates)).note if free.reached else ""


def explain(
    problem: Problem,
    plan: Trajectory,
    goals: JointGoals,
    binding: list[tuple[str, int]],
    attempt: Callable[[Problem], bool],
) -> Trajectory:
    """The failed plan with a note: how near it came, what stands in the way, and a duration that would do.

    Failed is what is not `reached`, or not `within_tolerance`.

    Parameters
    ----------
    problem : Problem
    plan : Trajectory
        The best there is.
    goals : JointGoals
        Joint goals that the search tried.
    binding : list of (str, int)
        Joint limits that the plan touches: kind and joint.
    attempt : callable
        Whether a problem, of another duration, can be solved.
    """
    words = []
    if not plan.reached:
        x, y, z = plan.end_effector[-1]
        words = [
            f"ends {plan.position_error[-1]:.4f} m from the target, at ({x:.4f}, {y:.4f}, {z:.4f}), "
            "the nearest position found"
        ]
        if plan.orientation_error[-1] > 0.0:
            words[0] += f", turned {plan.orientation_error[-1]:.4f} rad from the wanted attitude"
    if plan.note:
        words.append(plan.note)
    said = len(words)
    distance, least, most = distances(problem)
    tolerance = problem.goal.tolerance
    if not least - tolerance <= distance <= most + tolerance:
        words.append(
            f"binding: the workspace, since the end effector can be {least:.3f} to {most:.3f} m from the "
            f"system's centre of mass and the target is {distance:.3f} m from it"
        )
        if problem.goal.moves:
            words.append(time_within_reach(problem, least, most))
        return replace(plan, note="; ".join(words))
    fast = too_fast(problem, goals) if problem.goal.moves else ""
    if fast:
        words.append(fast)
    binds = [limit for limit in problem.limits if limit.name in plan.binding]
    others = [limit.name for limit in binds if limit.joint_bounds is None]
    if others:
        words.append(f"binding: {', '.join(others)}")
    if binding:
        names = [f"{kind} limit of '{problem.sms.joint_names[i]}'" for kind, i in binding[:3]]
        words.append(f"binding: {', '.join(names)}")
    if plan.reached:  # but not within the goal's tolerance: whether more time would do is not asked
        if len(words) == said:
            words.append("no limit binds; no motion was found that ends nearer")
        return replace(plan, note="; ".join(words))
    if problem.goal.exact:
        shortest = 0.0 if fast else later_deadline(problem, least, most, attempt)
    else:
        slow = any(kind in ("rate", "acceleration") for kind, _ in binding)
        slow = slow or any(limit.eased_by_time for limit in binds)
        shortest = _sufficient(problem, goals, slow, attempt)
    if shortest > 0.0:
        words.append(f"a duration of {shortest:.2f} s would do")
    else:
        words.append("no duration that would do is known")
    return replace(plan, note="; ".join(words), shortest_duration=shortest)


def within_workspace(problem: Problem) -> bool:
    """Whether the target is as far from the system's centre of mass as the end effector can be."""
    distance, least, most = distances(problem)
    return bool(least - problem.goal.tolerance <= distance <= most + problem.goal.tolerance)


def distances(problem: Problem) -> tuple[float, float, float]:
    """Of the target from the system's centre of mass at the deadline, and the range that can be had [m].

    How far a goal on the base is from it depends on the joints: it counts as within.
    """
    place, (least, most) = problem.goal.place(problem.duration), reach_range(problem)
    if place.moves_with_base:
        return 0.5 * (least + most), least, most
    way = place.position - problem.com0 - problem.duration * problem.drift
    return float(np.linalg.norm(way)), least, most


def reach_range(problem: Problem) -> tuple[float, float]:
    """Least and greatest distance of the end effector from the system's centre of mass, over the joint range.

    The base's attitude does not change it, and it holds for all motions from rest: the centre stays.
    """
    low, high = joint_range(problem)
    stack, seeds = problem.stack, spread_postures(problem, 0, 64)
    found = []
    for sense in (-1.0, 1.0):
        joints: FloatArray = seeds
        best = np.inf
        for k in range(40):
            arm = stack.evaluate(joints.T)
            distance = np.linalg.norm(arm.rho, axis=0)
            best = min(best, float((-sense * distance).min()))
            slope = np.einsum("inb,ib->bn", arm.arm - arm.linear / stack.mass, arm.rho)
            step = sense * slope / np.maximum(np.abs(slope).max(axis=1, keepdims=True), 1e-9)
            joints = np.clip(joints + 0.5 * 0.88**k * step, low, high)
        found.append(abs(best))
    return found[0], found[1]


def _sufficient(
    problem: Problem,
    goals: JointGoals,
    more_time_helps: bool,
    attempt: Callable[[Problem], bool],
) -> float:
    """The least duration [s] found for which the goal is met, by bisection; 0: none found.

    Without momentum a path can be gone in any time that the rates and accelerations of the joints, and the
    wheels, allow. So where none of these binds, and no straight move wants time, more time does not help.
    """
    if problem.goal.moves:
        return 0.0  # another deadline is another goal, for one that moves
    if not (more_time_helps or problem.momentum is not None or _wants_time(problem, goals)):
        return 0.0
    near = goals.distance <= 0.05 * problem.stack.length
    straight = [straight_time(problem, joints) for joints in goals.joints[near]]
    shorter = max(problem.duration, too_short(problem, goals))
    # A quarter longer than the failed one, a tenth longer than the straight move to the nearest goal takes.
    longer = max(1.25 * problem.duration, 1.1 * min(straight, default=0.0) / ARRIVAL_SHARE)
    for _ in range(3):
        if attempt(problem.lasting(longer)):
            break
        shorter, longer = longer, 2.0 * longer
    else:
        return 0.0
    while longer > _CLOSE * shorter:
        between = float(np.sqrt(longer * shorter))
        if attempt(problem.lasting(between)):
            longer = between
        else:
            shorter = between
    return longer


def _wants_time(problem: Problem, goals: JointGoals) -> bool:
    """Whether there is too little time for straight moves that end at the goal and keep the limits."""
    options = SearchOptions()
    there = goals.joints[goals.distance <= options.arrived_radius * problem.stack.length]
    slow = [straight_time(problem, joints) > ARRIVAL_SHARE * problem.duration for joints in there]
    return bool(keep_limits(Model.make(problem, options.fine), there[slow]).any())


def keep_limits(model: Model, goals: FloatArray) -> NDArray[np.bool_]:
    """Which straight moves to joint goals (K, n) keep the limits, were the joints quick enough."""
    if not len(goals):
        return np.zeros(0, dtype=bool)
    problem, spline = model.problem, model.spline
    p = moves_to(problem, spline, goals)
    # A joint that there is too little time for stops short of its goal; one that stays has no way to go.
    way = goals - problem.joints0
    done = spline.position_points.of(p, problem.joint_rates)[:, -1]
    p *= np.divide(way, done, out=np.ones_like(way), where=np.abs(done) > 1e-6)[:, None]
    return np.asarray(model.linearise(p, LAST_WEIGHTS, -np.inf).limit_share <= 1.0)
