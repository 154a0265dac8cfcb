"""The search for one problem: from several starts to one plan."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.horizon.approaches import moves_to
from ffsms_pin.opt.horizon.correction import corrected_goal
from ffsms_pin.opt.horizon.descent import Candidates, Model, descend
from ffsms_pin.opt.horizon.detours import among_obstacles, best_first, obstructed, pushed_aside
from ffsms_pin.opt.horizon.diagnosis import within_workspace
from ffsms_pin.opt.horizon.groups import QUICK, START_GROUPS, StartGroup
from ffsms_pin.opt.horizon.judge import Found, Judge, cost_of
from ffsms_pin.opt.horizon.marches import free_marches, march_starts
from ffsms_pin.opt.horizon.options import SearchOptions
from ffsms_pin.opt.horizon.shooting import JointGoals, joint_goals, too_short
from ffsms_pin.opt.horizon.spline import embedded
from ffsms_pin.opt.horizon.stages import (
    EARLY_STAGES,
    FINE_STAGES,
    STRAIGHT_STAGE,
    follow,
    prefer_limits,
    run,
    tighten,
)
from ffsms_pin.opt.horizon.starts import spread_postures
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.terms import Coupling
from ffsms_pin.opt.trajectory import Trajectory, measure

__all__ = ["Search"]


class Search:
    """The search for one problem; keeps what a diagnosis needs.

    Parameters
    ----------
    problem : Problem
    options : SearchOptions
    progress : callable, optional
        Called with the share of the work done, 0 to 1.
    """

    def __init__(
        self,
        problem: Problem,
        options: SearchOptions | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        self.problem, self.options = problem, options or SearchOptions()
        self._report = progress or (lambda share: None)
        self._coarse, self._fine = (
            Model.make(problem, one) for one in (self.options.coarse, self.options.fine)
        )
        self._judge = Judge(problem, self.options)
        self.goals = JointGoals(np.empty((0, problem.sms.n)), np.empty(0))
        self.found: list[Found] = []
        # Without the paper's cost "nearly free" says nothing: the first plan that meets a client will do.
        self._coupled = not problem.goal.exact or any(isinstance(term, Coupling) for term in problem.terms)
        # Among obstacles a way that is nearly free may not be there: a second group rarely finds one.
        self._content_factor = self.options.around_obstacles if among_obstacles(problem) else 1.0
        self._pool: Candidates | None = None
        self._drawn = 0
        self._started = time.perf_counter()

    def run(self, groups: tuple[StartGroup, ...] = START_GROUPS) -> Trajectory:
        """The best plan that arrives, or the one that comes nearest."""
        scale = self._judge.scale
        if self._is_near() and self._go_near():
            groups = ()
        for turn, group in enumerate(groups):
            self._gather(group)
            hopeless = turn == 0 and self._hopeless()
            if hopeless:
                group = QUICK[0]
            self._report((turn + 0.5) / len(groups))
            self._follow(group)
            content = scale * self._content_factor * group.content(self.problem.kappa)
            content = content if self._coupled else np.inf
            if hopeless and not self._arrived():
                return self.best().plan
            if self._arrived(content) or self._out_of_time() or hopeless:
                break
            if turn and not self._arrived() and not self._there().any():
                break  # neither motions of any shape nor straight moves end at the goal
        narrow = math.log(2.0) / self.problem.kappa < self.options.widest_cone
        if groups != QUICK and narrow and not self._out_of_time():
            self._march()
        if not self._arrived() and not self._out_of_time():
            self._go_straight()
        self._report(1.0)
        return self.best().plan

    def best(self) -> Found:
        """The best finished motion so far."""
        return self._judge.best(self.found)

    def binding(self) -> list[tuple[str, int]]:
        """Joint limits that the best plan touches: kind and joint."""
        found = self.best()
        return found.model.qp.active(found.p)

    # -- starts ----------------------------------------------------------------------------------------

    def _gather(self, group: StartGroup) -> None:
        """Add early motions to the pool: straight moves to new joint goals, and marches."""
        problem, coarse = self.problem, self._coarse
        near = spread_postures(problem, self._drawn, group.near, self.options.near_radius)
        far = spread_postures(problem, self._drawn, group.far)
        joints = np.vstack([problem.joints0, near, far] if not self._drawn else [near, far])
        self._drawn += max(group.near, group.far)
        goals = self._shoot(joints)
        length, half = problem.stack.length, (len(goals.distance) - 1) // 2
        reach = max(self.options.goal_radius * length, float(np.sort(goals.distance)[half]))
        p = moves_to(problem, coarse.spline, goals.joints[goals.distance <= reach])
        p = np.concatenate([p, pushed_aside(coarse, p, self._drawn)])
        if group.marches:
            p = np.concatenate([p, march_starts(problem, coarse.spline, self.options)])
        p = np.stack([coarse.qp.within(one) for one in p])
        first = EARLY_STAGES[0]
        early = Candidates.start(coarse, p, first.weights, first.damping or 0.3)
        early = run(coarse, early, EARLY_STAGES, first.weights)
        self._pool = early if self._pool is None else self._pool.join(early)

    def _shoot(self, joints: FloatArray) -> JointGoals:
        """Joint goals found from postures (K, n); those known grow by them."""
        goals = joint_goals(self.problem, joints)
        self.goals = JointGoals(*(np.concatenate(pair) for pair in zip(self.goals, goals, strict=True)))
        return goals

    def _there(self) -> NDArray[np.bool_]:
        """Which of the joint goals have straight moves that end at the goal."""
        return self.goals.distance <= self.options.arrived_radius * self.problem.stack.length

    def _hopeless(self) -> bool:
        """Whether the goal is out of the workspace, or the joints need far more time than there is."""
        far = float(self.goals.distance.min()) > self.options.goal_radius * self.problem.stack.length
        return (far and not within_workspace(self.problem)) or self.problem.duration < too_short(
            self.problem, self.goals
        )

    # -- to the end ------------------------------------------------------------------------------------

    def _follow(self, group: StartGroup) -> None:
        """Follow the best of the pool to their ends."""
        assert self._pool is not None
        found = follow(self._coarse, self._fine, self._pool, group.keep, group.repeats)
        before = len(self.found)
        for i in range(len(found.p)):
            if i == 0 or not self._out_of_time():
                self._finish(found.take([i]))
        self._within_limits(before)

    def _finish(self, motion: Candidates) -> None:
        """End on the fine spline; where the plan arrives but is not nearly free, on the finest one."""
        self._finish_finer(self._finish_on(self._fine, motion))

    def _finish_finer(self, found: Found) -> None:
        """Go on on the finest spline with a plan that arrives but is not nearly free."""
        weights, damping = FINE_STAGES[-1].weights, FINE_STAGES[-1].damping or 0.03
        cheap = not self._coupled or cost_of(found.plan) <= self.options.cost_tolerance
        if cheap or not found.plan.reached or self._out_of_time():
            return
        model = Model.make(self.problem, self.options.finest)
        p = embedded(found.model.spline, model.spline, found.p, self.problem.joint_rates)
        motion = Candidates.start(model, p[None], weights, damping)
        self._finish_on(model, descend(model, motion, weights, self.options.last_iterations))

    def _finish_on(self, model: Model, motion: Candidates) -> Found:
        """Land a motion and keep its plan; land again where the finished motion misses or breaks a limit."""
        problem = self.problem
        for _ in range(self.options.corrections):
            motion = tighten(model, motion)
            found = self._keep(model, motion.p[0])
            goal, broken = corrected_goal(problem, model.goal, found.plan), found.plan.broken
            if (goal is None and not broken) or motion.at.end_share[0] > 1.0 or motion.at.late_share[0] > 1.0:
                break
            aim = model.problem
            if broken:
                spare = self.options.limit_reserve * problem.stack.length
                limits = [one.tightened(broken.get(one.name, -spare) + spare) for one in aim.limits]
                aim = replace(aim, limits=limits)
            model = replace(model, problem=aim, goal=goal or model.goal)
            motion = Candidates.start(model, motion.p, FINE_STAGES[-1].weights, motion.damping)
        return found

    def _within_limits(self, before: int) -> None:
        """Where none of those found since arrives: the nearest, taken back within the limits."""
        nearest = self._judge.best(self.found[before:])
        if nearest.plan.broken and not self._arrived() and not self._out_of_time():
            weights, damping = FINE_STAGES[-1].weights, FINE_STAGES[-1].damping or 0.03
            model = replace(nearest.model, problem=self.problem, goal=self.problem.goal)
            motion = Candidates.start(model, nearest.p[None], weights, damping)
            self._keep(model, prefer_limits(model, motion).p[0])

    def _keep(self, model: Model, p: FloatArray) -> Found:
        problem = self.problem
        nodes = np.arange(problem.steps + 1, dtype=np.float64) * problem.dt
        rates = model.spline.rates_at(nodes).of(p, problem.joint_rates)
        rates[0] = problem.joint_rates
        self.found.append(Found(measure(problem, rates), p, model))
        return self.found[-1]

    # -- special ways ----------------------------------------------------------------------------------

    def _is_near(self) -> bool:
        """Whether const8 counts the start as arrived: then no way round is taken for the cost's sake.

        The paper's cost charges for standing still and for going straight, and nothing for length: for a
        target a millimetre away the cheapest motion can be a detour of centimetres.
        """
        problem = self.problem
        if problem.momentum is not None or problem.goal.moves or problem.joint_rates.any():
            return False
        start = problem.sms.at(problem.q0).end_effector_pose
        far, turned = problem.goal.place(problem.duration).error(start, problem.q0)
        return far <= problem.goal.reach and turned <= problem.goal.orientation_reach

    def _go_near(self) -> bool:
        """The straight move to the nearest joint goal; whether it arrives."""
        self.goals = joint_goals(self.problem, self.problem.joints0[None])
        self._go_to(self.goals.joints[0], 0)
        return self._arrived()

    def _march(self) -> None:
        """The paper's own marches, where one may be cheaper than the plan, or ask less of the joints."""
        goal, floats = self.problem.goal, self.problem.mode == "floating"
        place = goal.place(self.problem.duration)
        if goal.moves or self.problem.locked or not (place.rests and place.plain):
            return  # a march knows no such goal
        best, tolerance = self.best(), self.options.cost_tolerance
        cost = cost_of(best.plan) if self._arrived() else np.inf
        if cost < np.inf and obstructed(self.problem, best.plan):
            return  # a march stops at an obstacle that the plan goes round
        coupled = any(isinstance(term, Coupling) for term in self.problem.terms)
        if not floats or not coupled or (cost <= tolerance and not self._travels_far(best.plan)):
            return
        if cost == np.inf and not self._there().any():
            return
        for rates in free_marches(self.problem, max(cost - tolerance, tolerance)):
            self.found.append(best._replace(plan=measure(self.problem, rates)))
            done = self._arrived(tolerance) and not self._travels_far(self.best().plan)
            if done or self._out_of_time():
                break

    def _travels_far(self, plan: Trajectory) -> bool:
        """Whether the joints of a plan go much further than those of the straight moves."""
        ways = np.abs(self.goals.joints[self._there()] - self.problem.joints0).sum(axis=1)
        return plan.joint_travel > self.options.long_way * float(ways.min(initial=np.inf))

    def _go_straight(self) -> None:
        """Where every cheap way round fails: straight moves that end at the goal.

        First those that keep the limits, then the quickest. Where none does, more joint goals are looked for.
        """
        before = len(self.found)
        goals, good = best_first(self._fine, self.goals.joints[self._there()])
        if not good.any():
            self._shoot(spread_postures(self.problem, self._drawn, self.options.more_goals))
            self._drawn += self.options.more_goals
            goals, _ = best_first(self._fine, self.goals.joints[self._there()])
        for goal in goals[: self.options.straight_moves]:
            self._go_to(goal, STRAIGHT_STAGE.iterations)
            if self._arrived() or self._out_of_time():
                break
        if self._arrived():
            self._finish_finer(self.best())
        elif before < len(self.found):
            self._within_limits(before)

    def _go_to(self, goal: FloatArray, iterations: int) -> None:
        model = self._fine
        p = model.qp.within(moves_to(self.problem, model.spline, goal[None])[0])
        motion = Candidates.start(model, p[None], STRAIGHT_STAGE.weights, STRAIGHT_STAGE.damping or 1.0)
        self._finish_on(model, descend(model, motion, STRAIGHT_STAGE.weights, iterations))

    def _arrived(self, cost: float = np.inf) -> bool:
        """Whether there is a plan that arrives, as cheap as this."""
        least = self._judge.least_cost(self.found)
        return least <= cost and least < np.inf

    def _out_of_time(self) -> bool:
        limit = self.options.time_limit
        return limit is not None and bool(self.found) and time.perf_counter() - self._started > limit
