"""Plans of the rest of a motion with the present estimate of the robot, warm-started by the last plan."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.goals.goal import Changed, Goal
from ffsms_pin.opt.problem import Problem, free_momentum
from ffsms_pin.opt.replan.learning import Learner, learner_of
from ffsms_pin.opt.replan.options import Approach, Nearby, ReplanOptions
from ffsms_pin.opt.rollouts import held_momentum, wheel_shares
from ffsms_pin.opt.search.control_qp import ControlQP
from ffsms_pin.opt.search.diagnosis import refused
from ffsms_pin.opt.search.gauss_newton import LAST_WEIGHTS, Model, descend, linearise, motions_of
from ffsms_pin.opt.search.inverse_kinematics import within_workspace
from ffsms_pin.opt.search.search import QUICK, STRATEGIES, Search
from ffsms_pin.opt.search.spline import rate_spline
from ffsms_pin.opt.trajectory import Trajectory
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.threads import one_blas_thread


@dataclass(frozen=True, eq=False)
class JointPlan:
    """A planned joint motion; its rates are linear between nodes."""

    start: float  # [s] the time of the first node
    dt: float  # [s]
    joints: FloatArray  # (n,) joint positions at the first node
    rates: FloatArray  # (N + 1, n) joint rates at the nodes
    miss: float  # [m] the predicted distance to the goal at the deadline
    damping: float = 0.03  # the damping at the end of the descent
    excess: float = 0.0  # the largest residual of a limit divided by its margin; above 1: violated
    found: JointPlan | None = None  # the last plan that was searched or given; None: this plan is that plan

    @classmethod
    def of_trajectory(cls, plan: Trajectory, start: float = 0.0) -> JointPlan:
        """Return the joint motion of a trajectory that begins at `start` [s]."""
        miss, excess = float(plan.position_error[-1]), 2.0 if plan.broken else 0.0
        return cls(start, plan.dt, plan.joint_positions[0], plan.joint_rates, miss, excess=excess)

    def good(self, arrived: float) -> bool:
        """Return whether the plan ends within `arrived` [m] of the goal and satisfies the limits."""
        return self.miss <= arrived and self.excess <= 1.0

    @cached_property
    def positions(self) -> FloatArray:
        """The joint positions at the nodes (N + 1, n)."""
        travel = np.cumsum(0.5 * self.dt * (self.rates[1:] + self.rates[:-1]), axis=0)
        return self.joints + np.vstack([np.zeros(len(self.joints)), travel])

    def sample(self, t: float) -> tuple[FloatArray, FloatArray]:
        """Return joint positions and rates, each (n,), at t [s]; at rest after the last node."""
        place = (t - self.start) / self.dt
        k = min(max(int(place + 1e-9), 0), len(self.rates) - 2)
        h = (place - k) * self.dt
        if h > self.dt * (1.0 + 1e-6):
            return self.positions[-1], np.zeros_like(self.rates[-1])
        slope = (self.rates[k + 1] - self.rates[k]) / self.dt
        return self.positions[k] + h * (self.rates[k] + 0.5 * h * slope), self.rates[k] + h * slope

    def rates_at(self, times: FloatArray) -> FloatArray:
        """Return joint rates (k, n) at times (k,) [s]; zero after the last node."""
        nodes = self.start + self.dt * np.arange(len(self.rates))
        nodes[-1] += 1e-6 * self.dt  # rounding
        return np.stack([np.interp(times, nodes, column, right=0.0) for column in self.rates.T], axis=1)

    def accelerations_at(self, times: FloatArray) -> FloatArray:
        """Return joint accelerations (k, n) at times (k,) [s], constant in each step."""
        k = np.clip(((times - self.start) / self.dt + 1e-9).astype(int), 0, len(self.rates) - 2)
        return np.asarray((self.rates[k + 1] - self.rates[k]) / self.dt)

    def mended(
        self, rest: Problem, start: float, times: FloatArray, accelerations: FloatArray | None, jerk: Any
    ) -> FloatArray:
        """Return rates (k, n) that are added at `start` + `times` (k,) [s] for continuity with the command.

        The command has the joint rates of `rest` and `accelerations` (n,); None: those of the plan. If a
        limit or a single step has led the command away from the plan, the differences decay by a cubic
        Hermite polynomial. The decay of the rates takes at most half of the acceleration limits. The decays
        of rates and accelerations take at most half of the jerk limit each, if there is one.
        """
        dt, most = rest.dt, rest.sms.limits.acceleration
        jerk = np.inf if jerk is None else np.asarray(jerk)
        before, now, after = self.rates_at(start + dt * np.array([-1.0, 0.0, 1.0]))
        slope = (after - now if start < self.start + 0.5 * dt else now - before) / dt
        dv = rest.joint_rates - now
        da = np.zeros_like(dv) if accelerations is None else accelerations - slope
        v, a = np.abs(dv), np.abs(da)
        T = np.maximum.reduce((0.1 + 0.0 * v, 3.0 * v / most, 8.0 * a / jerk, np.sqrt(12.0 * v / jerk)))
        s = np.minimum(times[:, None] / T, 1.0)
        return np.asarray((dv * (1.0 + 2.0 * s) + da * T * s) * (1.0 - s) ** 2)


def rest_of(
    problem: Problem,
    sms: SpaceManipulator,
    t: float,
    q: FloatArray,
    joints: FloatArray,
    rates: FloatArray,
    base_start: FloatArray | None,
    locked: Sequence[str] = (),
    goal: Goal | None = None,
    wheel_total: FloatArray | None = None,
) -> Problem:
    """Return the problem of the rest of a motion from t [s] on, with the present robot estimate.

    `t` must be a multiple of `problem.dt`. The start has the base pose of the measured q (nq,), and the
    commanded joint positions `joints` (n,) and `rates` (n,). If the problem has joint limits, the positions
    are clipped to them. The defaults of `goal` and `wheel_total` are those of `problem`.
    """
    goal = problem.goal if goal is None else goal
    if any(limit.joint_bounds is not None for limit in problem.limits):
        joints = np.clip(joints, sms.limits.lower, sms.limits.upper)
    q0 = q.copy()
    sms.layout.set_positions(q0, joints)
    now = problem.wheel_momentum
    if problem.wheels is not None:  # by conservation of momentum, at the commanded joint rates
        arm = sms.arm_stack(problem.mode).evaluate(joints[:, None])
        total = problem.wheel_total if wheel_total is None else wheel_total
        now = total - wheel_shares(problem.wheels) @ held_momentum(arm)[..., 0] @ rates
    return replace(
        problem,
        sms=sms,
        q0=q0,
        goal=Changed(goal, time_offset=t) if goal.moves else goal,
        duration=(problem.steps - round(t / problem.dt)) * problem.dt,
        # The limits of the whole problem's goal are kept, also if `goal` is another goal.
        goal_limits=(),
        joint_rates=rates,
        locked=tuple(locked),
        wheel_momentum=now,
        base_start=base_start,
        time_offset=problem.time_offset + t,
    )


def replanned(
    problem: Problem,
    start: float,
    joints: FloatArray,
    last: JointPlan,
    options: ReplanOptions,
    accelerations: FloatArray | None = None,
    noisy: bool = False,
) -> JointPlan:
    """Return the plan of the rest of a motion (`rest_of`) from `start` [s] on, a change of the last plan.

    The plan continues the rates and `accelerations` (n,) of the command. If the rest of the last plan arrives
    within the limits, it is not changed further. Otherwise a spline is added that begins with zero rate and
    acceleration. The joint positions `joints` (n,) of the start are continuous in time, unlike the angles of
    continuous joints in a configuration. A fixed goal has a smaller tolerance, because there are unknown
    errors.
    """
    dt, fixed = problem.dt, ~problem.free
    nodes = problem.nodes
    rates = last.rates_at(start + nodes)
    rates += last.mended(problem, start, nodes, accelerations, options.jerk)
    rates[0] = problem.joint_rates  # the sum may differ by rounding errors
    most = np.maximum(problem.sms.limits.velocity, np.abs(rates[0]))
    rates = np.clip(rates, -most, most)  # the sum may exceed the limits slightly
    rates[:, fixed] = 0.0
    goal = problem.goal
    whole = rate_spline(problem.steps, dt, options.grid, not goal.place(problem.duration).rests)
    # With `firm`, an iteration would also penalise changes of a final pose within the tolerance.
    spline, weights = whole.around(dt, rates), LAST_WEIGHTS._replace(firm=False)
    searched = last.found or last
    if not goal.exact and not goal.moves:
        goal = Changed(goal, tolerance=(0.1 if noisy else 0.01) * goal.tolerance)
    nearby = Nearby(searched.accelerations_at(start + spline.times).T[:, None])
    terms = [nearby] if goal.exact or goal.moves else [nearby, Approach()]
    problem = replace(problem, goal=goal, terms=terms)
    model = Model(problem, goal, spline, ControlQP(problem, spline))
    motion = linearise(model, np.zeros((1, spline.size, len(joints))), weights, last.damping)
    # The plan is not changed within this share of the tolerance, larger for noisy estimates of an exact goal.
    enough = 0.9 if noisy and goal.exact else 0.5
    # The first descent has three iterations, because with two the commands depend on the last bits of the
    # measurements. Up to three stiffer descents of four iterations follow.
    for stage in range(4):
        # After the first descent a small error is accepted, because a stiffer goal would cause fast, late
        # motion.
        near = motion.end_share[0] * goal.tolerance <= 0.25 * options.arrived_miss if stage else False
        if (near or motion.end_share[0] <= enough) and motion.limit_share[0] <= 0.5:
            break
        if stage:
            weights = weights.stiffer()
            motion = linearise(model, motion.p, weights, motion.damping)
        motion = descend(motion, weights, 4 if stage else 3)
    rates += whole.rates_at(nodes).free[:, 1:] @ motion.p[0]
    ends = motions_of(problem, spline, motion.p)
    miss = float(np.linalg.norm(ends.to_target[:, 0, ends.last]))
    damping, excess = float(motion.damping[0]), float(motion.limit_share[0])
    return JointPlan(start, problem.dt, joints, rates, miss, damping, excess, searched)


class RestPlanner:
    """The planner of the first plan, by default by a search, and of all re-plans.

    `due` is the time of the next re-plan, and `made` that of the last plan [s]. `robot` is a new object after
    a change of the estimated masses. `wheel_total` (w,) [N m s] are the momenta of the wheels with arm and
    base at rest from the last observation, or None without one. `failed` (n,) is the mask of joints that do
    not move.
    """

    def __init__(
        self,
        problem: Problem,
        options: ReplanOptions,
        given: Trajectory | None = None,
        learn: Learner | None = None,
    ) -> None:
        self._problem, self._options, self.given = problem, options, given
        self.learner, self.noisy = learner_of(problem, learn), False
        self._needs_wheels = learn is not None and problem.wheels is not None
        self.robot = problem.sms
        self._rate_share = options.rate_share(problem.goal.exact)
        self._slower: tuple[SpaceManipulator, SpaceManipulator] | None = None
        self._base_start: FloatArray | None = None
        self._next_search = 0.0
        self.wheel_total: FloatArray | None = None
        self.momentum = problem.momentum
        self.failed: NDArray[np.bool_] = ~problem.free
        self.current: JointPlan | None = None
        self.made = self.due = self.computing_time = 0.0

    def observe(
        self,
        q: FloatArray,
        v: FloatArray,
        pushed: bool = False,
        t: float = 0.0,
        wheels: FloatArray | None = None,
        measured: tuple[FloatArray, FloatArray] | None = None,
    ) -> None:
        """Update the learner from a measured state q (nq,), v (6 + n,) at t [s].

        The base pose of the first state is the reference of base limits. `measured` is the unfiltered state,
        for a learner that models the sensors' noise. If the robot is `pushed`, its momentum has no
        information about masses, and is used for plans only. `wheels` (w,) are the measured momenta [N m s].
        """
        if self._base_start is None:
            self._base_start = q[:7].copy()
        if pushed:
            self.learner.pushed()
            self.momentum = free_momentum(self.robot.at(q, v).momentum, self._problem.mode)
        if self._needs_wheels and wheels is None:
            return
        if self.learner.update(t, *(measured or (q, v)), wheels):
            self.due = 0.0  # a body was captured, so the plan is obsolete

    def without(self, joint: int) -> None:
        """Exclude a failed joint (index from 0), and make a re-plan and a search due."""
        self.failed[joint] = True
        self.due = self._next_search = 0.0

    def renew_robot(self) -> None:
        """Update the robot if an estimated mass has changed."""
        self.robot = self.learner.learnt(self.robot)

    def _with_reserve(self) -> SpaceManipulator:
        """Return the robot with the share of its rate limits that plans use."""
        if self._rate_share == 1.0:
            return self.robot
        if self._slower is None or self._slower[0] is not self.robot:
            limits = self.robot.limits
            slower = self.robot.with_limits(replace(limits, velocity=self._rate_share * limits.velocity))
            self._slower = self.robot, slower
        return self._slower[1]

    @one_blas_thread()
    def plan(
        self,
        now: float,
        q: FloatArray,
        joints: FloatArray,
        rates: FloatArray,
        accelerations: FloatArray,
        goal: Goal,
    ) -> JointPlan:
        """Return the new plan of the rest of the motion from `now` [s] and the measured q (nq,).

        `joints`, `rates` and `accelerations` (n,) are those of the command. `goal` is the goal without the
        part of the error that the arm cannot correct (`Correctable.goal`).
        """
        begun, options, whole, last = time.perf_counter(), self._options, self._problem, self.current
        self.renew_robot()
        locked = [name for name, failed in zip(whole.sms.joint_names, self.failed, strict=True) if failed]
        settings = self._base_start, locked, goal, self.wheel_total
        rest = rest_of(whole, self._with_reserve(), now, q, joints, rates, *settings)
        if self.momentum is not whole.momentum:
            rest = replace(rest, momentum=self.momentum)
        if last is None:
            first = self.given or refused(rest)
            if first is None:  # like `opt.solve`, but without a diagnosis, which takes seconds
                first = Search(rest).run(STRATEGIES if within_workspace(rest) else QUICK)
            plan = JointPlan.of_trajectory(first, now)
            # The given plan begins at the expected start, not at the measured start.
            if self.given is not None:
                plan = replanned(rest, now, joints, plan, options, None, self.noisy)
        else:
            plan = replanned(rest, now, joints, last, options, accelerations, self.noisy)
        good, again = plan.good(options.arrived_miss), now + max(options.search_again, 0.25 * rest.duration)
        if good and not goal.exact:  # re-plans follow changes of masses more smoothly than a new search
            self._next_search = again
        elif last is not None and not good and now >= self._next_search:
            self._next_search = again
            other = self._searched_again(rest, now, joints, plan)
            if other is not plan:  # `other` begins with the commanded state, too
                plan = replanned(rest, now, joints, other, options, accelerations, self.noisy)
                plan = plan if plan.good(options.arrived_miss) else other
        self.current, self.made, self.computing_time = plan, now, time.perf_counter() - begun
        self.due = now + max(min(options.period, 0.1 * rest.duration), whole.dt)
        return plan

    def _searched_again(self, rest: Problem, now: float, joints: FloatArray, plan: JointPlan) -> JointPlan:
        """Search briefly, because `plan` misses the goal or violates a limit; return the better plan."""
        trajectory = Search(rest).run(QUICK)
        other = JointPlan.of_trajectory(trajectory, now)
        better = other.miss < plan.miss or (plan.excess > 1.0 and other.miss <= self._options.arrived_miss)
        # Continuous joints are unwrapped from their present positions.
        return plan if trajectory.broken or not better else replace(other, joints=joints)
