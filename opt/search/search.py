"""The search for the plan of a problem, its strategies, and the functions `solve` and `shortest`.

The strategies run in a fixed order. Each strategy first checks whether it is needed.
`benchmarks/strategies.py` measures the plans of searches that omit one strategy.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, ClassVar, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray, at_least_zero, instance, one_of, optional_callable, positive
from ffsms_pin.errors import InvalidValue, PartError, numerical_errors
from ffsms_pin.opt.costs import REFERENCE_TIME
from ffsms_pin.opt.evaluation import NUMERICAL
from ffsms_pin.opt.goals.goal import Changed
from ffsms_pin.opt.goals.path import Path
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.rollouts import ARRIVAL_SHARE
from ffsms_pin.opt.search.diagnosis import (
    arrives_while_tumbling,
    explain,
    keep_limits,
    moving_end_note,
    noted,
    refused,
    too_short,
    with_limit_notes,
)
from ffsms_pin.opt.search.gauss_newton import (
    LAST_WEIGHTS,
    Candidates,
    Model,
    arrival_error,
    coarse_stage,
    corrected_goal,
    descend,
    linearise,
    prefer_limits,
    refine,
    tighten,
    with_soft_goal,
)
from ffsms_pin.opt.search.inverse_kinematics import (
    JointGoals,
    joint_goals,
    least_time,
    moves_to,
    spread_postures,
    straight_time,
    within_workspace,
)
from ffsms_pin.opt.search.path_following import follow_path
from ffsms_pin.opt.search.spline import COARSE, FINE, Grid
from ffsms_pin.opt.step.stepwise import cheap_rollouts, plan_stepwise, sides_of
from ffsms_pin.opt.trajectory import Trajectory, measure
from ffsms_pin.options import Positive, Unit
from ffsms_pin.threads import one_blas_thread


@dataclass(frozen=True)
class SearchOptions:
    """The options of the search.

    Attributes
    ----------
    time_limit : float, optional
        The computing time [s] after which the search returns its best plan, if it has one. The time is
        checked between strategies, and within most strategies between motions. With a limit the plan depends
        on the speed of the computer. Default: no limit.
    cost_tolerance : float
        The search returns the motion of least effort among the motions that arrive and whose cost exceeds the
        least cost by at most this value [s]. The value is not scaled with the duration.
    without : sequence of str
        The names of the strategies to omit, for measurements; see `opt.search.search.STRATEGIES`.
    """

    time_limit: Annotated[Positive | None, Unit("s", "none")] = None
    cost_tolerance: float = 8e-4
    without: tuple[str, ...] = ()
    coarse: ClassVar[Grid] = COARSE
    fine: ClassVar[Grid] = FINE

    def __post_init__(self) -> None:
        if self.time_limit is not None:
            at_least_zero("time_limit", self.time_limit, "s")
        at_least_zero("cost_tolerance", self.cost_tolerance, "s")
        instance("without", self.without, (tuple, list))
        for name in self.without:
            one_of("without", name, dict.fromkeys(strategy.name for strategy in STRATEGIES))


class Strategy(NamedTuple):
    """A strategy, which adds initial guesses or motions to a search, with its name in `SearchOptions`."""

    name: str
    run: Callable[[Search], None]


class Search:
    """A search for the plan of a problem, with the motions and joint goals computed so far."""

    def __init__(
        self,
        problem: Problem,
        options: SearchOptions | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        self.problem, self.options = problem, options or SearchOptions()
        # If the problem has more than 2000 steps, motions are evaluated in 1000 steps during the search.
        self._judged = replace(problem, dt=problem.duration / 1000) if problem.steps > 2000 else problem
        self._report = progress or (lambda share: None)
        self.coarse = Model.make(problem, self.options.coarse)
        self.fine = Model.make(problem, self.options.fine)
        self.goals = JointGoals(np.empty((0, problem.sms.n)), np.empty(0))
        self.drawn = 0  # number of postures that were sampled for joint goals
        self.starts: FloatArray = np.empty(0)  # initial control points (K, M, n) on the coarse spline
        self.pool: Candidates | None = None  # the best motions from all starts after a few iterations
        self.found: list[Candidates] = []  # all finished motions
        self.fresh: list[Candidates] = []  # recently polished motions, for `within_limits`
        self.settled = False  # True if no further starts are needed
        self.hopeless = False  # True if no motion is expected to arrive
        # False for an exact goal without cost terms, for which the first plan that arrives is sufficient.
        self.costed = not problem.goal.exact or bool(problem.cost_terms)
        self._started = time.perf_counter()

    def run(self, strategies: Sequence[Strategy]) -> Trajectory:
        """Run strategies in order until the time limit; return the plan of the best motion (`best`)."""
        for i, strategy in enumerate(strategies):
            if self.out_of_time():
                break
            if strategy.name not in self.options.without:
                strategy.run(self)
            self._report((i + 1) / len(strategies))
        self._report(1.0)
        return self._best_in_full().plan

    def cost(self, plan: Trajectory) -> float:
        """Return the cost of a plan [s], or its whole objective if the problem has no cost terms."""
        return sum(plan.shares[term.name] for term in self.problem.cost_terms or self.problem.terms)

    def misses(self, plan: Trajectory) -> tuple[bool, bool, float]:
        """Return the sort key of a plan: failure, flaw, and error [m, rad, m/s, rad/s].

        The flaw of a plan that fails is a violated limit. The flaws of a plan that reaches its goal are an
        error above the tolerance, chatter, and joints that move at the deadline although the goal is at rest.
        """
        error = arrival_error(self.problem.goal, plan)
        if not plan.reached:
            return True, bool(plan.broken), error  # prefer missing the goal to violating a limit
        rates = plan.joint_rates
        moving = self.problem.place.rests and float(np.abs(rates[-1]).max()) > 1e-3  # [rad/s]
        # A motion chatters if its rates have more than eight sign changes per joint on average. Products
        # above -1e-8 are rounding errors.
        chatters = int(np.sum(rates[1:-1] * rates[2:] < -1e-8)) > 8 * self.problem.sms.n
        return False, error > self.problem.goal.tolerance or moving or chatters, error

    def arrives(self, plan: Trajectory) -> bool:
        """Return whether a plan reaches its goal without the flaws of `misses`."""
        return self.misses(plan)[:2] == (False, False)

    def best(self, candidates: Sequence[Candidates] | None = None) -> Candidates:
        """Return the best of the candidates; default: of all finished motions.

        The best motion has the least effort among the motions that arrive with nearly the least cost
        (`SearchOptions.cost_tolerance`). Effort is the sum of the tie-breakers (`Term.tie_breaker`), and cost
        the sum of the other terms. If no motion arrives, the best motion has the least key `misses`.
        """
        candidates = self.found if candidates is None else candidates
        arrived = [candidate for candidate in candidates if self.arrives(candidate.plan)]
        if not arrived:
            return min(candidates, key=lambda candidate: self.misses(candidate.plan))

        def share(candidate: Candidates, tie_breakers: bool) -> float:
            terms = (term for term in self.problem.terms if term.tie_breaker == tie_breakers)
            return sum(candidate.plan.shares[term.name] for term in terms)

        most = min(share(candidate, False) for candidate in arrived) + self.options.cost_tolerance
        alike = [candidate for candidate in arrived if share(candidate, False) <= most]
        return min(alike, key=lambda candidate: share(candidate, True))

    def add_joint_goals(self, joints: FloatArray) -> JointGoals:
        """Compute joint goals from postures (K, n), store them, and return them."""
        goals = joint_goals(self.problem, joints)
        self.goals = JointGoals(*(np.concatenate(pair) for pair in zip(self.goals, goals, strict=True)))
        return goals

    def polish(self, motion: Candidates) -> None:
        """Tighten a motion (`tighten`), and keep its plan.

        If the spline arrives but the plan misses the goal or violates a limit, repeat this with a displaced
        goal or a larger margin, up to three times.
        """
        problem = self.problem
        for _ in range(4):
            motion = tighten(motion)
            finished, model = self.keep(motion), motion.model
            goal, broken = corrected_goal(problem, model.goal, finished.plan), finished.plan.broken
            if (goal is None and not broken) or motion.end_share[0] > 1.0 or motion.late_share[0] > 1.0:
                break
            model = replace(model, problem=_stricter(model.problem, broken), goal=goal or model.goal)
            motion = linearise(model, motion.p, LAST_WEIGHTS, motion.damping)
        self.fresh.append(finished)

    def polish_each(self, motions: Candidates) -> None:
        """Polish motions in order until the time limit has passed, and at least the first motion."""
        for i in range(len(motions.p)):
            if i == 0 or not self.out_of_time():
                self.polish(motions.take([i]))

    def keep(self, motion: Candidates) -> Candidates:
        """Evaluate the plan of a candidate, and keep the candidate."""
        self.found.append(_measured(self._judged, motion))
        return self.found[-1]

    def keep_plan(self, plan: Trajectory) -> None:
        """Keep the plan of another method, with the control points nearest to its joint rates."""
        p = self.fine.spline.nearest(self.problem.nodes, plan.joint_rates, self.problem.joint_rates)
        self.found.append(linearise(self.fine, p[None], LAST_WEIGHTS, below=-np.inf)._replace(plan=plan))

    def arrived(self, cost: float = np.inf) -> bool:
        """Return whether a plan arrives with at most this cost [s]."""
        return any(
            self.cost(candidate.plan) <= cost for candidate in self.found if self.arrives(candidate.plan)
        )

    def fails_while_tumbling(self) -> bool:
        """Return whether a robot with angular momentum has plans, but none that reaches its fixed goal."""
        problem = self.problem
        still = not problem.goal.moves and problem.place.rests and not problem.place.moves_with_base
        reached = any(candidate.plan.reached for candidate in self.found)
        return problem.tumbles and still and bool(self.found) and not reached

    def out_of_time(self) -> bool:
        """Return whether the time limit has passed and a plan exists."""
        limit = self.options.time_limit
        return limit is not None and bool(self.found) and time.perf_counter() - self._started > limit

    def _best_in_full(self) -> Candidates:
        """Return the best motion, evaluated in all time steps of the problem.

        A motion that arrives only in the larger steps of the search is polished again.
        """
        while len((best := self.best()).plan.t) <= self.problem.steps:
            full = _measured(self.problem, best)
            self.found = [full if candidate is best else candidate for candidate in self.found]
            if self.arrives(best.plan) and not self.arrives(full.plan):
                self._judged = self.problem
                self.polish(linearise(best.model, best.p, LAST_WEIGHTS, 0.03))
        return best


def _stricter(problem: Problem, broken: Mapping[str, float]) -> Problem:
    """Return a problem with larger margins of the limits that a plan violates by `broken`."""
    spare, margins = 1e-4 * problem.stack.length, problem.extra_margins
    more = {name: margins.get(name, 0.0) + (by + spare) for name, by in broken.items()}
    return replace(problem, extra_margins={**margins, **more}) if more else problem


def _measured(problem: Problem, motion: Candidates) -> Candidates:
    """Return a candidate with its plan in the time steps of a problem."""
    rates = motion.model.spline.rates_at(problem.nodes).of(motion.p[0], problem.joint_rates)
    rates[0] = problem.joint_rates
    return motion._replace(plan=measure(problem, rates))


_COARSE_STEPS = 100  # number of steps of a coarse rollout; if it ends near the goal, a fine rollout follows
CHEAP = 0.01  # [s] the value of `cheap_cost` for 8 s, a large kappa and no obstacles


def cheap_cost(search: Search) -> float:
    """Return the cost [s] up to which a plan is cheap enough; infinity if the plan's cost is irrelevant.

    Above 8 s the value is proportional to the duration. With obstacles it is three times as large. It is also
    larger for a small kappa, because C~ exceeds max(0, cos(theta_a)) by up to log(2) / kappa.
    """
    problem = search.problem
    if not search.costed:
        return np.inf
    cost = CHEAP + 0.2 * (math.log(2.0) / problem.kappa) ** 2
    factor = 3.0 if any(limit.obstacles for limit in problem.limits) else 1.0
    return factor * max(1.0, problem.duration / REFERENCE_TIME) * cost


def straight_if_near(search: Search) -> None:
    """Plan the straight move if the start is within the goal's reach.

    If this plan arrives, no further starts are needed, because a cheaper motion would be a detour.
    """
    goal = search.problem.goal
    if starts_within(search.problem, goal.reach, goal.orientation_reach):
        search.add_joint_goals(search.problem.joints0[None])
        model = search.fine
        p = model.qp.within(moves_to(search.problem, model.spline, search.goals.joints)[0])
        search.polish(linearise(model, p[None], LAST_WEIGHTS, 1.0))
        search.settled = search.arrived()


def straight_starts(search: Search, near: int, far: int, enough: float = 0.0, insist: bool = True) -> None:
    """Set moves to joint goals as the next initial guesses.

    The joint goals are computed from `near` postures near the start and from `far` postures in the whole
    joint range, and in the first call also from the start itself. Later calls are skipped if the cost of a
    plan that arrives is at most `enough` times `cheap_cost`. Without `insist` a call is also skipped if
    neither a motion nor a straight move has reached the goal.
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
    goals = search.add_joint_goals(np.vstack([problem.joints0, *postures] if first else postures))
    # Moves that end within 0.05 arm lengths of the goal are used, and at least the nearer half of all moves.
    half = (len(goals.distance) - 1) // 2
    reach = max(0.05 * problem.stack.length, float(np.sort(goals.distance)[half]))
    joints = goals.joints[goals.distance <= reach]
    search.hopeless = first and _is_hopeless(search)
    if search.hopeless:  # if the duration is too short, the fastest moves end nearest to the goal
        joints = joints[np.argsort(straight_time(problem, joints))[:2]]
    search.starts = moves_to(problem, search.coarse.spline, joints)


def descend_from_starts(search: Search, keep: tuple[int, int, int], repeats: int) -> None:
    """Apply a few iterations to all starts, pool the best motions, and refine the best motions of the pool.

    For `keep` and `repeats` see `refine`. If the search is hopeless, only one motion is refined.
    """
    search.fresh, model = [], search.coarse
    if not len(search.starts):
        return
    if search.hopeless:
        keep, repeats = (1, 1, 1), 1
    early = coarse_stage(model, np.stack([model.qp.within(start) for start in search.starts]))
    search.pool = early if search.pool is None else search.pool.join(early)
    search.starts = search.starts[:0]
    search.polish_each(refine(search.pool, search.fine, keep, repeats))


def within_limits(search: Search) -> None:
    """Correct the best fresh motion by a weaker goal, if it violates a limit and no motion arrives.

    If the result violates a limit, too, start from parts of the motion and from rest.
    """
    if not search.fresh or search.arrived():
        return
    nearest, problem = search.best(search.fresh), search.problem
    if not nearest.plan.broken:
        return
    model = replace(nearest.model, problem=problem, goal=problem.goal)
    if not _keep_within(search, prefer_limits(linearise(model, nearest.p, LAST_WEIGHTS))).plan.broken:
        return
    for share in (0.7, 0.4, 0.2, 0.0):
        motion = search.keep(linearise(model, share * nearest.p, LAST_WEIGHTS))
        for softness in (1e-4, 1e-2):
            if search.out_of_time():
                return
            motion = _keep_within(search, with_soft_goal(motion, softness))
            if motion.plan.broken:
                break


def _keep_within(search: Search, motion: Candidates) -> Candidates:
    """Keep a motion, and return it, after corrections if only its plan violates a limit.

    A motion may satisfy the limits in the search's steps, but its plan may violate them between these steps.
    Then the motion is corrected with larger margins, up to twice.
    """
    motion = search.keep(motion)
    for _ in range(2):
        if not motion.plan.broken or motion.limit_share[0] > 1.0:
            break
        stricter = replace(motion.model, problem=_stricter(motion.model.problem, motion.plan.broken))
        motion = search.keep(with_soft_goal(linearise(stricter, motion.p, LAST_WEIGHTS), 0.1))
    return motion


def step_rollouts(search: Search) -> None:
    """Roll out the paper's step, if the rollout may have a lower cost or less joint travel than the plan."""
    problem = search.problem
    # C~ exceeds max(0, cos(theta_a)) by up to log(2) / kappa. If this error is 0.2 or more, rollouts spiral.
    wide = math.log(2.0) / problem.kappa >= 0.2
    if (
        search.settled
        or wide
        or not problem.cost_terms
        or problem.mode != "floating"
        or not _supports_rollouts(problem)
    ):
        return
    cost, tolerance, cheap = np.inf, search.options.cost_tolerance, cheap_cost(search)
    if search.arrived():
        best = search.best().plan
        cost = search.cost(best)
        if any(limit.obstacles and limit.name in best.binding for limit in problem.limits):
            return  # a rollout stops at an obstacle that the plan avoids
        if cost <= cheap and not _travels_far(search, best):
            return
    elif search.hopeless or not len(search.goals.arrived(search.problem)):
        return
    for rates in cheap_rollouts(problem, max(cost - tolerance, tolerance), sides_of(problem)):
        search.keep_plan(measure(problem, rates))
        done = search.arrived(cheap) and not _travels_far(search, search.best().plan)
        if done or search.out_of_time():
            break


def straight_moves_to_goal(search: Search, most: int = 6) -> None:
    """Polish up to `most` straight moves that end at the goal, regardless of cost, if no plan arrives."""
    search.fresh = []
    if search.hopeless or search.arrived():
        return
    problem, model, goals = search.problem, search.fine, search.goals.arrived(search.problem)
    times = straight_time(problem, goals)
    # Polishing may change the final posture to a posture that is reached sooner.
    possible = times <= 1.1 * problem.duration
    goals, times = goals[possible], times[possible]
    # The moves within the limits are polished first, and the faster moves before the slower ones.
    poor = ~keep_limits(model, goals) | (times > ARRIVAL_SHARE * problem.duration)
    weights = LAST_WEIGHTS.stiffer()
    for goal in goals[np.lexsort((times, poor))][:most]:
        p = model.qp.within(moves_to(problem, model.spline, goal[None])[0])
        search.polish(descend(linearise(model, p[None], weights, 1.0), weights, 10))
        if search.arrived() or search.out_of_time():
            break


def reaches(problem: Problem, options: SearchOptions | None, joints: FloatArray) -> bool:
    """Return whether straight moves to joint goals near `joints` (K, n) solve a problem.

    If K is 0, return whether a quick search solves the problem.
    """
    search = Search(problem, options)
    if not len(joints):
        return search.run(QUICK).reached
    search.add_joint_goals(joints)
    straight_moves_to_goal(search, most=2)
    return search.arrived()


def moving_end(search: Search) -> None:
    """Plan with moving joints at the deadline, if no plan of a tumbling robot reaches its goal.

    The base rotates, so the joints must move to keep the end effector at rest in inertial axes.
    """
    if not search.fails_while_tumbling():
        return
    problem = search.problem
    model, rates = Model.make(problem, search.options.fine, free_end=True), search.best().plan.joint_rates
    p = model.qp.within(model.spline.nearest(problem.nodes, rates, problem.joint_rates))
    motion = descend(linearise(model, p[None], LAST_WEIGHTS), LAST_WEIGHTS, 15)
    search.polish(motion)
    if search.fails_while_tumbling():  # holding the end effector with a stiffer goal takes more iterations
        search.polish(tighten(motion, iterations=15))


def at_the_deadline_alone(search: Search) -> None:
    """Plan to reach the goal only at the deadline, if no plan of a tumbling robot stays at its goal."""
    if not search.fails_while_tumbling():
        return
    goal, rates = search.problem.goal, search.best().plan.joint_rates
    anywhere = Changed(goal, reach=1e3 * search.problem.stack.length, orientation_reach=1e3)
    problem = replace(search.problem, goal=anywhere)
    other, model = Search(problem, search.options), Model.make(problem, search.options.fine)
    straight = moves_to(problem, model.spline, search.goals.arrived(problem)[:2])
    for p in (model.spline.nearest(problem.nodes, rates, problem.joint_rates), *straight):
        start = linearise(model, model.qp.within(p)[None], LAST_WEIGHTS)
        other.polish(descend(start, LAST_WEIGHTS, 15))
        if other.arrived() or search.out_of_time():
            break
    search.keep(other.best()._replace(model=model))


def straight_line(search: Search) -> None:
    """Roll out steps of the method "resolved-rate" straight to the target, if no plan reaches it."""
    problem = search.problem
    if any(candidate.plan.reached for candidate in search.found) or not _supports_rollouts(problem):
        return
    if problem.steps > 2 * _COARSE_STEPS:
        coarse = plan_stepwise(replace(problem, dt=problem.duration / _COARSE_STEPS), "resolved-rate")
        if coarse.position_error[-1] > 5.0 * problem.goal.reach:
            return
    plan = plan_stepwise(problem, "resolved-rate")
    if plan.reached:
        search.keep_plan(plan)


def _descent(keep: tuple[int, int, int], repeats: int) -> tuple[Strategy, Strategy]:
    """Return the strategies `descend_from_starts` and `within_limits`."""
    return Strategy("descent", partial(descend_from_starts, keep=keep, repeats=repeats)), _WITHIN


_WITHIN = Strategy("within limits", within_limits)
_NEAR = Strategy("straight if near", straight_if_near)
_STRAIGHT = Strategy("straight moves", straight_moves_to_goal)
# The cost after a few iterations predicts the final cost poorly. So if the first plans are not cheap, the
# next strategies refine more motions with more iterations.
STRATEGIES = (
    _NEAR,
    Strategy("first starts", partial(straight_starts, near=3, far=4)),
    *_descent(keep=(3, 2, 1), repeats=1),
    Strategy("more starts", partial(straight_starts, near=4, far=8, enough=1.0)),
    *_descent(keep=(6, 4, 2), repeats=2),
    Strategy("most starts", partial(straight_starts, near=4, far=20, enough=3.0, insist=False)),
    *_descent(keep=(10, 6, 4), repeats=4),
    Strategy("step rollouts", step_rollouts),
    _STRAIGHT,
    _WITHIN,
    Strategy("straight line", straight_line),
    Strategy("moving end", moving_end),
    Strategy("deadline alone", at_the_deadline_alone),
)
# The strategies of a quick search, which ends with the first plans that arrive, regardless of their cost.
QUICK = (
    _NEAR,
    Strategy("first starts", partial(straight_starts, near=4, far=4)),
    *_descent(keep=(1, 1, 1), repeats=2),
    _STRAIGHT,
    _WITHIN,
)


def starts_within(problem: Problem, reach: float, orientation_reach: float) -> bool:
    """Return whether a robot at rest starts at a fixed goal.

    Its pose error may be up to `reach` [m] and `orientation_reach` [rad].
    """
    if problem.momentum is not None or problem.goal.moves or problem.joint_rates.any():
        return False
    start = problem.sms.at(problem.q0).end_effector_pose
    distance, angle = problem.place.error(start, problem.q0)
    return bool(distance <= reach and angle <= orientation_reach)


def _is_hopeless(search: Search) -> bool:
    """Return whether the goal is outside the workspace, or the duration is far too short for the joints."""
    problem, goals = search.problem, search.goals
    out_of_reach = not len(goals.near(problem)) and not within_workspace(problem)
    return out_of_reach or problem.duration < too_short(problem, goals)


def _supports_rollouts(problem: Problem) -> bool:
    """Return whether a problem can be planned by rollouts of single steps."""
    return not (problem.goal.moves or problem.locked) and problem.place.rests and problem.place.plain


def _travels_far(search: Search, plan: Trajectory) -> bool:
    """Return whether a plan has more than three times the joint travel of the shortest move to the goal."""
    travels = np.abs(search.goals.arrived(search.problem) - search.problem.joints0).sum(axis=1)
    return plan.joint_travel > 3.0 * float(travels.min(initial=np.inf))


@numerical_errors("the plan")
@one_blas_thread()
def solve(
    problem: Problem,
    options: SearchOptions | None = None,
    progress: Callable[[float], None] | None = None,
) -> Trajectory:
    """Plan a motion by optimisation of the whole motion (docs/planner.md).

    The plan is the motion of least effort among the motions that arrive with nearly the least cost
    (`SearchOptions.cost_tolerance`). After a numerical failure the plan has a `note`. A motion along an
    `opt.Path` is planned by rollouts and descents of the redundant motion.

    Parameters
    ----------
    problem : Problem
        The problem.
    options : SearchOptions, optional
        The options of the search.
    progress : callable, optional
        A function that is called with the completed share of the work, 0 to 1.

    Raises
    ------
    InvalidValue
        If the start overlaps an obstacle, the target is inside an obstacle, a path without an approach does
        not begin at the end effector, or an option is not for paths.
    PartError
        If a user's own term or limit fails.
    """
    instance("problem", problem, Problem)
    instance("options", options, SearchOptions, optional=True)
    optional_callable("progress", progress)
    if (stays := refused(problem)) is not None:
        return stays
    if isinstance(problem.goal, Path):
        plan = follow_path(problem, options, progress)
        return noted(plan, plan.note, _momentum_note(problem))

    def again(other: Problem) -> Trajectory:
        return Search(other, options).run(QUICK)

    search = Search(problem, options, progress)
    try:
        plan = search.run(STRATEGIES)
        if not _finite(plan):
            raise FloatingPointError("the motion has values that are not finite")
        if not plan.reached and within_workspace(problem) and not arrives_while_tumbling(problem, plan):
            plan = with_limit_notes(problem, plan, again)
        if not (plan.reached and plan.within_tolerance):
            best = search.best()
            binding = best.model.qp.active(best.p[0])
            plan = explain(
                problem, plan, search.goals, binding, lambda other, joints: reaches(other, options, joints)
            )
    except (*NUMERICAL, PartError) as error:
        if isinstance(error, PartError) and not isinstance(error.__cause__, NUMERICAL):
            raise  # a programming error in a term or limit
        plan = _before_failure(search, error)
    return noted(plan, plan.note, moving_end_note(problem, plan), _momentum_note(problem))


@numerical_errors("the search for the shortest plan")
def shortest(problem: Problem, tolerance: float = 0.05, options: SearchOptions | None = None) -> Trajectory:
    """Return the plan of least duration, by bisection that begins with the duration of the problem.

    The duration of the result is an upper bound of the least duration, because a search may miss a plan.

    Parameters
    ----------
    problem : Problem
        The problem.
    tolerance : float
        The relative tolerance of the duration, below 1. The bisection ends if the duration of the plan
        exceeds the duration of a failed search by at most this share, or after 20 searches.
    options : SearchOptions, optional
        The options of every search.

    Returns
    -------
    Trajectory
        The plan. Its `shortest_duration` is its duration [s]. Its `note` has the longest duration for which
        the bisection found no plan, and the least time under the joint limits. If no plan is found for the
        duration of the problem or for the duration that the diagnosis proposes, the failed plan is returned.

    Raises
    ------
    InvalidValue
        If the goal of the problem is a path, the tolerance is out of range, or `solve` raises it.
    """
    instance("problem", problem, Problem)
    if isinstance(problem.goal, Path):
        remedy = 'must not follow a path; for least time use opt.Path(..., timing="fastest") in opt.solve'
        raise InvalidValue("problem", problem, remedy)
    if positive("tolerance", tolerance) >= 1.0:
        raise InvalidValue("tolerance", tolerance, "must be below 1, for example 0.05")
    best = solve(problem, options)
    if not best.reached and best.shortest_duration > 0.0:
        best = solve(problem.lasting(best.shortest_duration), options)
    if not best.reached:
        return best
    failed = 0.0
    for _ in range(20):
        if failed and best.duration <= (1.0 + tolerance) * failed:
            break
        trial = float(np.sqrt(failed * best.duration)) if failed else best.duration / 1.5
        plan = Search(problem.lasting(trial), options).run(QUICK)
        if plan.reached:
            best = plan
        else:
            failed = trial
    displacement = best.joint_positions[-1] - best.joint_positions[0]
    bound = least_time(problem.sms.limits, displacement, best.joint_rates[0], best.joint_rates[-1])
    shorter = f"none was found in {failed:.3g} s" if failed else "the search ended before a duration failed"
    note = (
        f"the shortest motion found; {shorter}; the limits of joint rates and "
        f"accelerations alone take {bound:.3g} s for the move to its last posture"
    )
    return noted(best, best.note, note, shortest_duration=best.duration)


def _momentum_note(problem: Problem) -> str:
    """Return a message if the momentum of a problem differs from the momentum that its goal requires."""
    required = problem.required_momentum
    if required is None:
        return ""
    momentum = np.zeros(6) if problem.momentum is None else problem.momentum
    linear, angular = np.linalg.norm((momentum - required).reshape(2, 3), axis=1)
    if np.allclose([linear, angular], 0.0, atol=1e-6 * float(np.abs(required).max()) + 1e-9):
        return ""  # the difference is a rounding error
    return (
        f"the momentum before the capture differs by {linear:.3g} kg m/s and {angular:.3g} kg m^2/s from the "
        "momentum that leaves both at rest; robot and client keep this difference after the capture"
    )


def _before_failure(search: Search, error: Exception) -> Trajectory:
    """Return the best plan found before a numerical failure, or a plan at rest if there is none."""
    problem, finite = search.problem, [candidate for candidate in search.found if _finite(candidate.plan)]
    if finite:
        plan, outcome = search.best(finite).plan, "this is the best motion found before it"
    else:
        plan = measure(problem, np.zeros((problem.steps + 1, problem.sms.n)))
        outcome = "the arm stays at rest"
    note = f"the search ended in a numerical failure ({error}): {outcome}"
    return noted(plan, note, plan.note)


def _finite(plan: Trajectory) -> bool:
    return bool(np.isfinite(plan.q).all() and np.isfinite(plan.position_error).all())
