"""The strategies of the search, in the order in which they are tried.

Each is a few lines on the same solver, and says itself whether it has anything to do. A row of
`benchmarks/strategies.py` shows what is lost without it: what loses nothing goes.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.horizon.descent import LAST_WEIGHTS, descend, follow, prefer_limits, take_down
from ffsms_pin.opt.horizon.diagnosis import keep_limits, too_short, within_workspace
from ffsms_pin.opt.horizon.marches import free_marches, marched, sides_of
from ffsms_pin.opt.horizon.merit import linearise
from ffsms_pin.opt.horizon.search import Search, SearchOptions, Strategy
from ffsms_pin.opt.horizon.shooting import moves_to, spread_postures, straight_time
from ffsms_pin.opt.motion.motions import ARRIVAL_SHARE
from ffsms_pin.opt.parts.term import REFERENCE_TIME
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.trajectory import Trajectory, measure

_REHEARSAL = 100  # steps of a march that shows whether one in all steps is worth its time
CHEAP = 0.01  # [s] the cost of a motion of 8 s up to which no cheaper one is looked for


def cheap_cost(search: Search) -> float:
    """Return the cost [s] up to which a plan is cheap enough, infinity if any cost is.

    C~ exceeds max(0, cos(theta_a)) by up to log 2 / kappa, costs grow with durations beyond 8 s, and ways
    round obstacles cost more.
    """
    problem = search.problem
    if not search.costed:
        return np.inf
    cost = CHEAP + 0.2 * (math.log(2.0) / problem.kappa) ** 2
    around = 3.0 if any(limit.obstacles for limit in problem.limits) else 1.0
    return around * max(1.0, problem.duration / REFERENCE_TIME) * cost


def straight_if_near(search: Search) -> None:
    """Where const8 counts the start as arrived, the straight move: no way round for the cost's sake."""
    goal = search.problem.goal
    if starts_within(search.problem, goal.reach, goal.orientation_reach):
        search.shoot(search.problem.joints0[None])
        model = search.fine
        p = model.qp.within(moves_to(search.problem, model.spline, search.goals.joints)[0])
        search.finish(model, linearise(model, p[None], LAST_WEIGHTS, 1.0))
        search.settled = search.arrived()


def straight_starts(search: Search, near: int, far: int, enough: float = 0.0, insist: bool = True) -> None:
    """Add straight moves to joint goals that are found from postures near the start, and from all over.

    Nothing is done if there is a plan that costs at most `enough` times what is cheap; without `insist`
    neither if no motion and no straight move has ended at the goal.
    """
    problem, first = search.problem, not search.drawn
    done = not first and search.arrived(enough * cheap_cost(search))
    if search.settled or search.hopeless or done:
        return
    if not insist and not search.arrived() and not len(search.goals.arrived(search.problem)):
        return
    postures = [
        spread_postures(problem, search.drawn, near, radius=1.0),  # [rad or m]
        spread_postures(problem, search.drawn, far),
    ]
    search.drawn += max(near, far)
    goals = search.shoot(np.vstack([problem.joints0, *postures] if first else postures))
    # Those that end further away are tried only where less than half of the group ends nearer.
    half = (len(goals.distance) - 1) // 2
    reach = max(0.05 * problem.stack.length, float(np.sort(goals.distance)[half]))
    joints = goals.joints[goals.distance <= reach]
    search.hopeless = first and _is_hopeless(search)
    if search.hopeless:  # the quickest ones come nearest
        joints = joints[np.argsort(straight_time(problem, joints))[:2]]
    search.starts = moves_to(problem, search.coarse.spline, joints)


def descend_from_starts(search: Search, keep: tuple[int, int, int], repeats: int) -> None:
    """A few iterations with every start, which join the pool; of this the best go on, see `follow`."""
    search.fresh, model = [], search.coarse
    if not len(search.starts):
        return
    if search.hopeless:
        keep, repeats = (1, 1, 1), 1
    early = take_down(model, np.stack([model.qp.within(one) for one in search.starts]))
    search.pool = early if search.pool is None else search.pool.join(early)
    search.starts = search.starts[:0]
    search.finish_each(search.fine, follow(model, search.fine, search.pool, keep, repeats))


def within_limits(search: Search) -> None:
    """Where none of those found arrives: the nearest, taken back within the limits."""
    if not search.fresh or search.arrived():
        return
    nearest = search.best(search.fresh)
    if nearest.plan.broken:
        model = replace(nearest.model, problem=search.problem, goal=search.problem.goal)
        motion = linearise(model, nearest.p[None], LAST_WEIGHTS)
        search.keep(model, prefer_limits(model, motion).p[0])


def marches(search: Search) -> None:
    """The paper's own marches, where one may be cheaper than the plan, or ask less of the joints."""
    problem = search.problem
    # Where C~ exceeds max(0, cos(theta_a)) by more, a march spirals.
    wide = math.log(2.0) / problem.kappa >= 0.2
    if wide or not problem.cost_terms or problem.mode != "floating" or not _can_march(problem):
        return
    cost, tolerance, cheap = np.inf, search.options.cost_tolerance, cheap_cost(search)
    if search.arrived():
        best = search.best().plan
        cost = search.cost(best)
        if any(limit.obstacles and limit.name in best.binding for limit in problem.limits):
            return  # a march stops at an obstacle that the plan goes round
        if cost <= cheap and not _travels_far(search, best):
            return
    elif search.hopeless or not len(search.goals.arrived(search.problem)):
        return
    for rates in free_marches(problem, max(cost - tolerance, tolerance), sides_of(problem)):
        search.keep_plan(measure(problem, rates))
        done = search.arrived(cheap) and not _travels_far(search, search.best().plan)
        if done or search.out_of_time():
            break


def straight_moves_that_end_there(search: Search, most: int = 6) -> None:
    """Try a few straight moves that end at the goal, whatever they cost, if every cheap way fails."""
    search.fresh = []
    if search.hopeless or search.arrived():
        return
    problem, model, goals = search.problem, search.fine, search.goals.arrived(search.problem)
    times = straight_time(problem, goals)
    possible = times <= 1.1 * problem.duration  # a posture beside the goal's may be a little quicker to reach
    goals, times = goals[possible], times[possible]
    # First those that keep the limits, then the quickest.
    poor = ~keep_limits(model, goals) | (times > ARRIVAL_SHARE * problem.duration)
    weights = LAST_WEIGHTS.stiffer()
    for goal in goals[np.lexsort((times, poor))][:most]:
        p = model.qp.within(moves_to(problem, model.spline, goal[None])[0])
        search.finish(model, descend(model, linearise(model, p[None], weights, 1.0), weights, 10))
        if search.arrived() or search.out_of_time():
            break


def reaches(problem: Problem, options: SearchOptions | None, joints: FloatArray) -> bool:
    """Return whether a problem is solved by straight moves to joint goals near these (K, n), or by a search.

    A quick search is made if there are no joint goals.
    """
    search = Search(problem, options)
    if not len(joints):
        return search.run(QUICK).reached
    search.shoot(joints)
    straight_moves_that_end_there(search, most=2)
    return search.arrived()


def straight_line(search: Search) -> None:
    """March straight to the target by single steps, as "resolved-rate" does, if nothing else arrives."""
    problem = search.problem
    if any(one.plan.reached for one in search.found) or not _can_march(problem):
        return
    if problem.steps > 2 * _REHEARSAL:
        rehearsed = marched(replace(problem, dt=problem.duration / _REHEARSAL), "resolved-rate")
        if rehearsed.position_error[-1] > 5.0 * problem.goal.reach:
            return
    plan = marched(problem, "resolved-rate")
    if plan.reached:
        search.keep_plan(plan)


def _descent(keep: tuple[int, int, int], repeats: int) -> tuple[Strategy, Strategy]:
    """Return a descent from the starts, and the strategy for motions that end beyond a limit."""
    return Strategy("descent", partial(descend_from_starts, keep=keep, repeats=repeats)), _WITHIN


_WITHIN = Strategy("within limits", within_limits)
_NEAR = Strategy("straight if near", straight_if_near)
_STRAIGHT = Strategy("straight moves", straight_moves_that_end_there)
# An early motion says little of what it comes to in the end, so where the first plans are not nearly free,
# more are followed, and longer.
STRATEGIES = (
    _NEAR,
    Strategy("first starts", partial(straight_starts, near=3, far=4)),
    *_descent(keep=(3, 2, 1), repeats=1),
    Strategy("more starts", partial(straight_starts, near=4, far=8, enough=1.0)),
    *_descent(keep=(6, 4, 2), repeats=2),
    Strategy("most starts", partial(straight_starts, near=4, far=20, enough=3.0, insist=False)),
    *_descent(keep=(10, 6, 4), repeats=4),
    Strategy("marches", marches),
    _STRAIGHT,
    _WITHIN,
    Strategy("straight line", straight_line),
)
# For a plan at any cost.
QUICK = (
    _NEAR,
    Strategy("first starts", partial(straight_starts, near=4, far=4)),
    *_descent(keep=(1, 1, 1), repeats=2),
    _STRAIGHT,
    _WITHIN,
)


def starts_within(problem: Problem, reach: float, orientation_reach: float) -> bool:
    """Whether an arm that is to stay where its goal is starts so near to it [m, rad]."""
    if problem.momentum is not None or problem.goal.moves or problem.joint_rates.any():
        return False
    start = problem.sms.at(problem.q0).end_effector_pose
    far, turned = problem.place.error(start, problem.q0)
    return bool(far <= reach and turned <= orientation_reach)


def _is_hopeless(search: Search) -> bool:
    """Whether the goal is out of the workspace, or the joints need far more time than there is."""
    problem, goals = search.problem, search.goals
    out_of_reach = not len(goals.near(problem)) and not within_workspace(problem)
    return out_of_reach or problem.duration < too_short(problem, goals)


def _can_march(problem: Problem) -> bool:
    """Whether a march knows the goal."""
    return not (problem.goal.moves or problem.locked) and problem.place.rests and problem.place.plain


def _travels_far(search: Search, plan: Trajectory) -> bool:
    """Whether the joints of a plan go three times as far as those of the shortest straight move."""
    ways = np.abs(search.goals.arrived(search.problem) - search.problem.joints0).sum(axis=1)
    return plan.joint_travel > 3.0 * float(ways.min(initial=np.inf))
