"""Plans of what is left of a motion, each from the rest of the one before, for the robot as known by then."""

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
from ffsms_pin.opt.problem import Problem
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
    """A plan of the joints (n,) from `start` on: rates (N + 1, n) at nodes, linear between."""

    start: float  # [s]
    dt: float  # [s]
    joints: FloatArray
    rates: FloatArray
    miss: float  # [m] distance to the goal at the deadline, as foreseen
    damping: float = 0.03  # with which the descent that made it ended
    excess: float = 0.0  # the largest residual of a limit, as a share of its margin: above one it is broken
    found: JointPlan | None = None  # the plan of a search that this one is made of; None: itself

    @classmethod
    def of_trajectory(cls, plan: Trajectory, start: float = 0.0) -> JointPlan:
        """Return the joint motion of a trajectory that begins at `start`."""
        miss, excess = float(plan.position_error[-1]), 2.0 if plan.broken else 0.0
        return cls(start, plan.dt, plan.joint_positions[0], plan.joint_rates, miss, excess=excess)

    def good(self, arrived: float) -> bool:
        """Return whether the plan comes within `arrived` [m] of the goal and keeps the limits."""
        return self.miss <= arrived and self.excess <= 1.0

    @cached_property
    def positions(self) -> FloatArray:
        """The joint positions at the nodes (N + 1, n)."""
        travel = np.cumsum(0.5 * self.dt * (self.rates[1:] + self.rates[:-1]), axis=0)
        return self.joints + np.vstack([np.zeros(len(self.joints)), travel])

    def sample(self, t: float) -> tuple[FloatArray, FloatArray]:
        """Return joint positions and rates, each (n,), at t [s]; beyond the ends at rest."""
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
        """Return joint accelerations (k, n) at times (k,) [s]."""
        k = np.clip(((times - self.start) / self.dt + 1e-9).astype(int), 0, len(self.rates) - 2)
        return np.asarray((self.rates[k + 1] - self.rates[k]) / self.dt)

    def mended(
        self, rest: Problem, start: float, times: FloatArray, accelerations: FloatArray | None, jerk: Any
    ) -> FloatArray:
        """Return rates (k, n) to add at `start` + times [s], so that they continue the commanded ones.

        Where a limit or a step of its own has led the command away from the plan, the rates of `rest` and
        `accelerations` (n,) fade out to it by Hermite's cubic: within half of the accelerations that there
        may be, and of the jerk where that is limited.
        """
        dt, most = rest.dt, rest.sms.limits.acceleration
        jerk = np.inf if jerk is None else np.asarray(jerk)
        before, now, after = self.rates_at(start + dt * np.array([-1.0, 0.0, 1.0]))
        slope = (after - now if start < self.start + 0.5 * dt else now - before) / dt
        off = rest.joint_rates - now
        turn = np.zeros_like(off) if accelerations is None else accelerations - slope
        far, hard = np.abs(off), np.abs(turn)
        times_needed = 0.1 + 0.0 * far, 3.0 * far / most, 8.0 * hard / jerk, np.sqrt(12.0 * far / jerk)
        time = np.maximum.reduce(times_needed)
        s = np.minimum(times[:, None] / time, 1.0)
        return np.asarray((off * (1.0 + 2.0 * s) + turn * time * s) * (1.0 - s) ** 2)


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
    """Return the problem from t [s] on, a whole number of steps, with the robot as it is known now.

    Its base is where q (nq,) was measured, its joints (n,) [rad] and rates [rad/s] are as commanded; `goal`
    and `wheel_total` are by default those of the whole problem.
    """
    goal = problem.goal if goal is None else goal
    if any(limit.joint_bounds is not None for limit in problem.limits):
        joints = np.clip(joints, sms.limits.lower, sms.limits.upper)
    q0 = q.copy()
    sms.layout.set_positions(q0, joints)
    now = problem.wheel_momentum
    if problem.wheels is not None:  # momentum is conserved: what the joints have of it, the wheels lack
        arm = sms.arm_stack(problem.mode).evaluate(joints[:, None])
        total = problem.wheel_total if wheel_total is None else wheel_total
        now = total - wheel_shares(problem.wheels) @ held_momentum(arm)[..., 0] @ rates
    return replace(
        problem,
        sms=sms,
        q0=q0,
        goal=Changed(goal, time_offset=t) if goal.moves else goal,
        duration=(problem.steps - round(t / problem.dt)) * problem.dt,
        goal_limits=(),  # they stay, also with another goal
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
    """Return the plan of the rest (`rest_of`) from `start` [s] on: that of the last plan, changed smoothly.

    A change begins with zero rate and acceleration, and there is none where the rest of the last plan arrives
    and keeps the limits. The plan goes on with the rates and `accelerations` (n,) of the command. Joints (n,)
    are counted continuously in time, which those of a configuration are not where they turn without end. Of
    the tolerance of a goal that stands still a share is used: the rest is left to what is not known yet.
    """
    dt, fixed = problem.dt, ~problem.free
    nodes = problem.nodes
    rates = last.rates_at(start + nodes)
    rates += last.mended(problem, start, nodes, accelerations, options.jerk)
    rates[0] = problem.joint_rates  # to the bit
    most = np.maximum(problem.sms.limits.velocity, np.abs(rates[0]))
    rates = np.clip(rates, -most, most)  # both together may ask for a little more
    rates[:, fixed] = 0.0
    goal = problem.goal
    whole = rate_spline(problem.steps, dt, options.grid, not goal.place(problem.duration).rests)
    spline, weights = whole.around(dt, rates), LAST_WEIGHTS._replace(firm=False)  # it must get there first
    searched = last.found or last
    if not goal.exact and not goal.moves:
        goal = Changed(goal, tolerance=(0.1 if noisy else 0.01) * goal.tolerance)
    nearby = Nearby(searched.accelerations_at(start + spline.times).T[:, None])
    terms = [nearby] if goal.exact or goal.moves else [nearby, Approach()]
    problem = replace(problem, goal=goal, terms=terms)
    model = Model(problem, goal, spline, ControlQP(problem, spline))
    motion = linearise(model, np.zeros((1, spline.size, len(joints))), weights, last.damping)
    enough = 0.9 if noisy and goal.exact else 0.5  # of the tolerance: an estimate of its place jumps by some
    # With two iterations commands jump with the last bits of what is measured. Stiffer, up to 12 more follow.
    for stage in range(4):
        # After the first descent the arm is near enough for a stiffer goal to make it hurry.
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
    """A planner of the first motion, by default by a search, and of all re-plans; the next is `due` at [s].

    `robot` is another object whenever an estimated mass has changed; `wheel_total` (w,) [N m s] is what the
    wheels would have, were all else at rest, as last observed, or None; `failed` (n,) joints do not move.
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
        """Learn from a measured state; the base's turn and shift count from the first one.

        `measured` is the state as the sensors show it, for a learner that counts on their noise. While
        something pushes from outside, the momentum says nothing of masses; plans go by it.
        """
        if self._base_start is None:
            self._base_start = q[:7].copy()
        if pushed:
            self.learner.pushed()
            self.momentum = self.robot.at(q, v).momentum
        if self._needs_wheels and wheels is None:
            return
        if self.learner.update(t, *(measured or (q, v)), wheels):
            self.due = 0.0  # a body was captured: the plan is that of another robot

    def without(self, joint: int) -> None:
        """Plan without a joint, at once."""
        self.failed[joint] = True
        self.due = self._next_search = 0.0

    def renew_robot(self) -> None:
        """Take the masses as estimated by now, if one has changed."""
        self.robot = self.learner.learnt(self.robot)

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
        """Plan the rest from `now` [s], q (nq,) as measured, to the goal as far as the arm can come to it."""
        begun, options, whole, last = time.perf_counter(), self._options, self._problem, self.current
        self.renew_robot()
        locked = [name for name, failed in zip(whole.sms.joint_names, self.failed, strict=True) if failed]
        known = self._base_start, locked, goal, self.wheel_total
        rest = rest_of(whole, self.robot, now, q, joints, rates, *known)
        if self.momentum is not whole.momentum and whole.mode == "floating":
            rest = replace(rest, momentum=self.momentum)
        if last is None:
            first = self.given or refused(rest)
            if first is None:  # as `opt.solve`, but without a diagnosis, which would take seconds
                first = Search(rest).run(STRATEGIES if within_workspace(rest) else QUICK)
            plan = JointPlan.of_trajectory(first, now)
            if self.given is not None:  # it begins where it was thought to, with no noise in its rates
                plan = replanned(rest, now, joints, plan, options, None, self.noisy)
        else:
            plan = replanned(rest, now, joints, last, options, accelerations, self.noisy)
        good, again = plan.good(options.arrived_miss), now + max(options.search_again, 0.25 * rest.duration)
        if good and not goal.exact:  # what masses change, re-plans follow more calmly than another way
            self._next_search = again
        elif last is not None and not good and now >= self._next_search:
            self._next_search = again
            other = self._searched_again(rest, now, joints, plan)
            if other is not plan:  # it, too, begins with what is commanded
                plan = replanned(rest, now, joints, other, options, accelerations, self.noisy)
                plan = plan if plan.good(options.arrived_miss) else other
        self.current, self.made, self.computing_time = plan, now, time.perf_counter() - begun
        self.due = now + max(min(options.period, 0.1 * rest.duration), whole.dt)
        return plan

    def _searched_again(self, rest: Problem, now: float, joints: FloatArray, plan: JointPlan) -> JointPlan:
        """Search briefly if the rest of a plan misses or breaks a limit; return the better one."""
        found = Search(rest).run(QUICK)
        other = JointPlan.of_trajectory(found, now)
        better = other.miss < plan.miss or (plan.excess > 1.0 and other.miss <= self._options.arrived_miss)
        # Joints that turn without end are counted from where they are.
        return plan if found.broken or not better else replace(other, joints=joints)
