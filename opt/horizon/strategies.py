"""The strategies of the search, in the order in which they are tried.

Each is a few lines on the same solver, and says itself whether it has anything to do. A row of
`benchmarks/strategies.py` shows what is lost without it: what loses nothing goes.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np

from ffsms_pin.opt.horizon.descent import LAST_WEIGHTS, descend, follow, prefer_limits, take_down
from ffsms_pin.opt.horizon.diagnosis import keep_limits, too_short, within_workspace
from ffsms_pin.opt.horizon.marches import free_marches, march_starts, marched, sides_that_lead_on
from ffsms_pin.opt.horizon.merit import Model, linearise
from ffsms_pin.opt.horizon.search import Search, Strategy
from ffsms_pin.opt.horizon.shooting import moves_to, spread_postures, straight_time
from ffsms_pin.opt.horizon.spline import embedded
from ffsms_pin.opt.motion.motions import ARRIVAL_SHARE
from ffsms_pin.opt.parts.term import REFERENCE_TIME
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.trajectory import Trajectory, measure


def straight_if_near(search: Search) -> None:
    """Where const8 counts the start as arrived, the straight move: no way round for the cost's sake."""
    goal = search.problem.goal
    if starts_within(search.problem, goal.reach, goal.orientation_reach):
        search.shoot(search.problem.joints0[None])
        model = search.fine
        p = model.qp.within(moves_to(search.problem, model.spline, search.goals.joints)[0])
        search.finish(model, linearise(model, p[None], LAST_WEIGHTS, 1.0))
        search.settled = search.arrived()


def straight_starts(
    search: Search, near: int, far: int, enough: tuple[float, float] = (0.0, 0.0), insist: bool = True
) -> None:
    """Straight moves to joint goals that are found from so many postures near the start, and from all over.

    Nothing is done where a plan is as cheap as `enough`: the first plus the second times (log 2 / kappa)^2
    [s, for a motion of 8 s], by so much C~ may exceed max(0, cos(theta_a)). Without `insist` nothing is done
    either where no motion and no straight move has ended at the goal.
    """
    problem, first = search.problem, not search.drawn
    free, by_kappa = enough
    scale = max(1.0, problem.duration / REFERENCE_TIME)  # costs grow with the duration beyond that
    most = scale * (free + by_kappa * (math.log(2.0) / problem.kappa) ** 2)
    if any(limit.obstacles for limit in problem.limits):
        most *= 3.0
    if not search.costed:
        most = np.inf
    if search.settled or search.hopeless or search.arrived(most):
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
    search.starts = moves_to(problem, search.coarse.spline, goals.joints[goals.distance <= reach])
    search.hopeless = first and _is_hopeless(search)


def coarse_marches(search: Search) -> None:
    """Coarse marches of the paper's step."""
    if len(search.starts):
        marches = march_starts(search.problem, search.coarse.spline)
        search.starts = np.concatenate([search.starts, marches])


def descend_from_starts(search: Search, keep: tuple[int, int, int], repeats: int) -> None:
    """A few iterations with every start, which join the pool; of this the best go on, see `follow`."""
    search.fresh, model = [], search.coarse
    if not len(search.starts):
        return
    if search.hopeless:
        keep, repeats = (1, 1, 1), 2
    early = take_down(model, np.stack([model.qp.within(one) for one in search.starts]))
    search.pool = early if search.pool is None else search.pool.join(early)
    search.starts = search.starts[:0]
    search.finish_each(search.fine, follow(model, search.fine, search.pool, keep, repeats))


def finest_spline(search: Search) -> None:
    """Plans that arrive but are not nearly free go on on the finest spline: the last tenth still costs."""
    problem, options = search.problem, search.options
    nearly_free = options.cost_tolerance if search.costed else np.inf
    poor = [one for one in search.fresh if one.plan.reached and search.cost(one.plan) > nearly_free]
    if not poor or search.out_of_time():
        return
    model = Model.make(problem, options.finest)
    p = np.stack([embedded(one.model.spline, model.spline, one.p, problem.joint_rates) for one in poor])
    found = descend(model, linearise(model, p, LAST_WEIGHTS), LAST_WEIGHTS, 10)
    search.finish_each(model, found)


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
    cost, tolerance = np.inf, search.options.cost_tolerance
    if search.arrived():
        best = search.best().plan
        cost = search.cost(best)
        if any(limit.obstacles and limit.name in best.binding for limit in problem.limits):
            return  # a march stops at an obstacle that the plan goes round
        if cost <= tolerance and not _travels_far(search, best):
            return
    elif search.hopeless or not len(search.goals.arrived(search.problem)):
        return
    sides = sides_that_lead_on(search.coarse)
    for rates in free_marches(problem, max(cost - tolerance, tolerance), sides):
        search.keep_plan(measure(problem, rates))
        done = search.arrived(tolerance) and not _travels_far(search, search.best().plan)
        if done or search.out_of_time():
            break


def straight_moves_that_end_there(search: Search) -> None:
    """Where every cheap way fails: half a dozen straight moves that end at the goal, whatever they cost."""
    search.fresh = []
    if search.hopeless or search.arrived():
        return
    problem, model, goals = search.problem, search.fine, search.goals.arrived(search.problem)
    times = straight_time(problem, goals)
    # First those that keep the limits, then the quickest.
    poor = ~keep_limits(model, goals) | (times > ARRIVAL_SHARE * problem.duration)
    weights = LAST_WEIGHTS.stiffer()
    for goal in goals[np.lexsort((times, poor))][:6]:
        p = model.qp.within(moves_to(problem, model.spline, goal[None])[0])
        search.finish(model, descend(model, linearise(model, p[None], weights, 1.0), weights, 10))
        if search.arrived() or search.out_of_time():
            break


def straight_line(search: Search) -> None:
    """Where nothing else reaches: straight to the target by single steps, as method "resolved-rate" goes."""
    if not any(one.plan.reached for one in search.found) and _can_march(search.problem):
        plan = marched(search.problem, "resolved-rate")
        if plan.reached:
            search.keep_plan(plan)


def _descent(keep: tuple[int, int, int], repeats: int) -> tuple[Strategy, ...]:
    """A descent from the starts, and what is made of the motions that it ends with."""
    descent = Strategy("descent", partial(descend_from_starts, keep=keep, repeats=repeats))
    return descent, Strategy("finest spline", finest_spline), _WITHIN


_WITHIN = Strategy("within limits", within_limits)
_NEAR = Strategy("straight if near", straight_if_near)
_STRAIGHT = Strategy("straight moves", straight_moves_that_end_there)
# An early motion says little of what it comes to in the end, so where the first plans are not nearly free,
# more are followed, and longer.
STRATEGIES = (
    _NEAR,
    Strategy("first starts", partial(straight_starts, near=3, far=4)),
    Strategy("coarse marches", coarse_marches),
    *_descent(keep=(3, 2, 1), repeats=1),
    Strategy("more starts", partial(straight_starts, near=4, far=8, enough=(3e-3, 0.2))),
    *_descent(keep=(6, 4, 2), repeats=2),
    Strategy("most starts", partial(straight_starts, near=4, far=20, enough=(0.03, 0.5), insist=False)),
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
