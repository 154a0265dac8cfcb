"""The search for one problem: its numbers, what strategies share, and which finished motion is the plan."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray, at_least_zero, instance
from ffsms_pin.opt.horizon.descent import LAST_WEIGHTS, arrival_error, corrected_goal, tighten
from ffsms_pin.opt.horizon.merit import Candidates, Model, linearise
from ffsms_pin.opt.horizon.shooting import JointGoals, joint_goals
from ffsms_pin.opt.horizon.spline import Grid
from ffsms_pin.opt.limits.limit import tightened
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.trajectory import Trajectory, measure


@dataclass(frozen=True)
class SearchOptions:
    """What can be chosen of the search; other numbers, tuned on the packaged robots, stand beside their use.

    Attributes
    ----------
    time_limit : float, optional
        After so long [s] the best plan so far is returned; looked at between motions. Default: no limit.
    cost_tolerance : float
        Of motions that cost at most so much more than the cheapest one, the one of least effort is taken [s,
        whatever the duration].
    without : sequence of str
        Names of strategies that are left out (`strategies.STRATEGIES`), to see what each earns.
    """

    time_limit: float | None = None
    cost_tolerance: float = 8e-4
    without: tuple[str, ...] = ()
    # Splines of ten control points a joint, enough for a zigzag of three strokes, and of seventeen.
    coarse: ClassVar[Grid] = Grid(6, 3, 2)
    fine: ClassVar[Grid] = Grid(12, 5, 3)

    def __post_init__(self) -> None:
        if self.time_limit is not None:
            at_least_zero("time_limit", self.time_limit, "s")
        at_least_zero("cost_tolerance", self.cost_tolerance, "s")
        instance("without", self.without, (tuple, list))


class Found(NamedTuple):
    """A finished motion, and its control points (M, n) on a model's spline."""

    plan: Trajectory
    p: FloatArray
    model: Model


class Strategy(NamedTuple):
    """A way to find starts or motions: its name, for `SearchOptions.without`, and what it does."""

    name: str
    run: Callable[[Search], None]


class Search:
    """The search for one problem: finds motions, ranks them, keeps what a diagnosis needs; see `solve`."""

    def __init__(
        self,
        problem: Problem,
        options: SearchOptions | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        self.problem, self.options = problem, options or SearchOptions()
        # What the search makes of a motion does not need all the steps of a long one.
        self._judged = replace(problem, dt=problem.duration / 1000) if problem.steps > 2000 else problem
        self._report = progress or (lambda share: None)
        self.coarse = Model.make(problem, self.options.coarse)
        self.fine = Model.make(problem, self.options.fine)
        self.goals = JointGoals(np.empty((0, problem.sms.n)), np.empty(0))
        self.drawn = 0  # postures, for these goals
        # Control points (K, M, n) on the coarse spline, and what a few iterations made of those before.
        self.starts: FloatArray = np.empty(0)
        self.pool: Candidates | None = None
        # Finished motions: all, and what the last starts came to.
        self.found: list[Found] = []
        self.fresh: list[Found] = []
        # Whether no cheaper way is wanted, and whether none that arrives is expected.
        self.settled = self.hopeless = False
        # Whether "nearly free" says something: else the first plan that meets a client will do.
        self.costed = not problem.goal.exact or bool(problem.cost_terms)
        self._started = time.perf_counter()

    def run(self, strategies: Sequence[Strategy]) -> Trajectory:
        """The best plan that arrives, or the one that comes nearest."""
        for i, strategy in enumerate(strategies):
            if self.out_of_time():
                break
            if strategy.name not in self.options.without:
                strategy.run(self)
            self._report((i + 1) / len(strategies))
        self._report(1.0)
        return self._best_in_full().plan

    def cost(self, plan: Trajectory) -> float:
        """What the terms that measure cost come to, where there are any; else the whole objective [s]."""
        return sum(plan.shares[term.name] for term in self.problem.cost_terms or self.problem.terms)

    def misses(self, plan: Trajectory) -> tuple[bool, bool, float]:
        """Whether a plan fails, whether it arrives poorly, and by how much it misses."""
        error = arrival_error(self.problem.goal, plan)
        if not plan.reached:
            return True, bool(plan.broken), error  # rather short of the goal than beyond a limit
        rates = plan.joint_rates
        moving = self.problem.place.rests and float(np.abs(rates[-1]).max()) > 1e-3  # [rad/s]
        # A motion with more than eight changes of sign a joint chatters; those of rounding do not count.
        chatters = int(np.sum(rates[1:-1] * rates[2:] < -1e-8)) > 8 * self.problem.sms.n
        return False, error > self.problem.goal.tolerance or moving or chatters, error

    def arrives(self, plan: Trajectory) -> bool:
        """Whether a plan reaches its goal within the tolerance, at rest where that is asked for."""
        return self.misses(plan)[:2] == (False, False)

    def best(self, found: Sequence[Found] | None = None) -> Found:
        """Of motions (default: all) that arrive and cost about as little as any, the one of least effort.

        Effort is the share of the tie-breakers (`Term.tie_breaker`). Where none arrives: that misses least.
        """
        found = self.found if found is None else found
        arrived = [one for one in found if self.arrives(one.plan)]
        if not arrived:
            return min(found, key=lambda one: self.misses(one.plan))

        def share(one: Found, tie_breakers: bool) -> float:
            terms = (term for term in self.problem.terms if term.tie_breaker == tie_breakers)
            return sum(one.plan.shares[term.name] for term in terms)

        most = min(share(one, False) for one in arrived) + self.options.cost_tolerance
        alike = [one for one in arrived if share(one, False) <= most]
        return min(alike, key=lambda one: share(one, True))

    def shoot(self, joints: FloatArray) -> JointGoals:
        """Joint goals found from postures (K, n); those known grow by them."""
        goals = joint_goals(self.problem, joints)
        self.goals = JointGoals(*(np.concatenate(pair) for pair in zip(self.goals, goals, strict=True)))
        return goals

    def finish(self, model: Model, motion: Candidates) -> None:
        """Land a motion and keep its plan; land again where the finished motion misses or breaks a limit."""
        problem = self.problem
        for _ in range(4):
            motion = tighten(model, motion)
            found = self.keep(model, motion.p[0])
            goal, broken = corrected_goal(problem, model.goal, found.plan), found.plan.broken
            if (goal is None and not broken) or motion.end_share[0] > 1.0 or motion.late_share[0] > 1.0:
                break
            aim = model.problem
            if broken:
                spare = 1e-4 * problem.stack.length
                limits = [tightened(one, broken.get(one.name, -spare) + spare) for one in aim.limits]
                aim = replace(aim, limits=limits)
            model = replace(model, problem=aim, goal=goal or model.goal)
            motion = linearise(model, motion.p, LAST_WEIGHTS, motion.damping)
        self.fresh.append(found)

    def finish_each(self, model: Model, motions: Candidates) -> None:
        """Each of several motions, as long as there is time; the first in any case."""
        for i in range(len(motions.p)):
            if i == 0 or not self.out_of_time():
                self.finish(model, motions.take([i]))

    def keep(self, model: Model, p: FloatArray) -> Found:
        """Measure the finished motion of control points (M, n), and keep it."""
        self.found.append(_measured(self._judged, model, p))
        return self.found[-1]

    def keep_plan(self, plan: Trajectory) -> None:
        """Keep a motion that was made in another way, with the nearest control points."""
        p = self.fine.spline.nearest(self.problem.nodes, plan.joint_rates, self.problem.joint_rates)
        self.found.append(Found(plan, p, self.fine))

    def arrived(self, cost: float = np.inf) -> bool:
        """Whether there is a plan that arrives, as cheap as this [s]."""
        return any(self.cost(one.plan) <= cost for one in self.found if self.arrives(one.plan))

    def out_of_time(self) -> bool:
        """Whether there is a plan and no time for another."""
        limit = self.options.time_limit
        return limit is not None and bool(self.found) and time.perf_counter() - self._started > limit

    def _best_in_full(self) -> Found:
        """The best finished motion, measured in full; where that no longer arrives it is landed again."""
        while len((best := self.best()).plan.t) <= self.problem.steps:
            full = _measured(self.problem, best.model, best.p)
            self.found = [full if one is best else one for one in self.found]
            if self.arrives(best.plan) and not self.arrives(full.plan):
                self._judged = self.problem
                self.finish(best.model, linearise(best.model, best.p[None], LAST_WEIGHTS, 0.03))
        return best


def _measured(problem: Problem, model: Model, p: FloatArray) -> Found:
    """The finished motion of control points (M, n) in a problem's steps."""
    rates = model.spline.rates_at(problem.nodes).of(p, problem.joint_rates)
    rates[0] = problem.joint_rates
    return Found(measure(problem, rates), p, model)
