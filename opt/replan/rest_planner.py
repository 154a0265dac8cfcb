"""Plans of the rest of a motion, one after the other, for the robot as it is known by then."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.goals import Goal
from ffsms_pin.opt.horizon.diagnosis import within_workspace
from ffsms_pin.opt.horizon.search import Search
from ffsms_pin.opt.horizon.solve import refused
from ffsms_pin.opt.horizon.strategies import QUICK, STRATEGIES
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.replan.approach import Approach, narrower
from ffsms_pin.opt.replan.options import ReplanOptions
from ffsms_pin.opt.replan.reaction import ReactionEstimate
from ffsms_pin.opt.replan.rest import JointPlan, replanned, rest_of
from ffsms_pin.opt.trajectory import Trajectory
from ffsms_pin.threads import one_blas_thread

__all__ = ["RestPlanner"]


class RestPlanner:
    """Makes the first plan and all that follow, and says when the next one is due.

    Parameters
    ----------
    problem : Problem
        The whole one.
    options : ReplanOptions
    given : Trajectory, optional
        The first plan; default: a search.

    Attributes
    ----------
    robot : SpaceManipulator
        As it is known now; another object whenever an estimated mass has changed.
    failed : ndarray of bool, shape (n,)
        Joints that cannot be moved.
    current : JointPlan or None
        The last plan.
    wheel_total : ndarray, shape (w,), or None
        Momenta of the wheels that hold the attitude, were all else at rest, as last observed [N m s]; None:
        the problem's.
    made, due : float
        When that was made, and when the next one is due [s].
    computing_time : float
        That the last plan took [s].
    """

    def __init__(self, problem: Problem, options: ReplanOptions, given: Trajectory | None = None) -> None:
        self._problem, self._options, self._given = problem, options, given
        self._estimate, self.robot = ReactionEstimate(problem.sms, problem.mode), problem.sms
        self._known: FloatArray = np.ones(problem.sms.n + 1)
        self._base_start: FloatArray | None = None
        self._next_search = 0.0
        self.wheel_total: FloatArray | None = None
        self.failed: NDArray[np.bool_] = ~problem.free
        self.current: JointPlan | None = None
        self.made = self.due = self.computing_time = 0.0

    def observe(self, q: FloatArray, v: FloatArray) -> None:
        """Learn from a measured state; the base's turn and shift count from the first one."""
        if self._base_start is None:
            self._base_start = q[:7].copy()
        if self._estimate.observe(q, v):
            self.due = 0.0  # a body was captured: the plan is that of another robot

    def expect_noise(self) -> None:
        """Count on noise in what is observed."""
        self._estimate.noisy = True

    def without(self, joint: int) -> None:
        """Plan without a joint, at once."""
        self.failed[joint] = True
        self.due = self._next_search = 0.0

    @one_blas_thread()
    def plan(self, now: float, q: FloatArray, joints: FloatArray, rates: FloatArray, goal: Goal) -> JointPlan:
        """Plan the rest of the motion.

        Parameters
        ----------
        now : float
            [s]
        q : ndarray, shape (nq,)
            Measured configuration.
        joints, rates : ndarray, shape (n,)
            Commanded joint positions [rad] and rates [rad/s].
        goal : Goal
            The problem's, as far as the arm can come to it.
        """
        begun, options, whole, last = time.perf_counter(), self._options, self._problem, self.current
        self._learn()
        locked = [name for name, failed in zip(whole.sms.joint_names, self.failed, strict=True) if failed]
        base_start = q[:7] if self._base_start is None else self._base_start
        rest = rest_of(whole, self.robot, now, q, joints, rates, base_start, locked, goal, self.wheel_total)
        if last is None:
            plan = JointPlan.of_trajectory(self._given or _searched(rest), now)
        else:
            plan = replanned(self._careful(rest), now, joints, last, options, rest.duration / whole.duration)
            if plan.miss > options.arrived_miss and now >= self._next_search:
                plan = self._searched_again(rest, now, joints, plan)
        self.computing_time = time.perf_counter() - begun
        self.current, self.made = plan, now
        self.due = now + max(min(options.period, options.share * rest.duration), whole.dt)
        return plan

    def _searched_again(self, rest: Problem, now: float, joints: FloatArray, plan: JointPlan) -> JointPlan:
        """A short search, where the rest of the plan does not arrive; the better of both."""
        self._next_search = now + max(self._options.search_again, 0.25 * rest.duration)
        found = Search(rest).run(QUICK)
        other = JointPlan.of_trajectory(found, now)
        if found.broken or other.miss >= plan.miss:
            return plan
        # Joints that turn without end are counted from where they are.
        return replace(other, positions=other.positions + joints - other.positions[0])

    def _careful(self, rest: Problem) -> Problem:
        """With noisy sensors: the goal met more narrowly, without ways away from it."""
        goal = rest.goal
        if not self._estimate.noisy or goal.exact or goal.moves:
            return rest
        return replace(rest, goal=narrower(goal), terms=[*rest.terms, Approach()])

    def _learn(self) -> None:
        """Take over the estimated masses, where they have changed."""
        factors = self._estimate.solve()
        if np.abs(factors - self._known).max() > self._options.changed:
            self._known, self.robot = factors, self._estimate.robot()


def _searched(problem: Problem) -> Trajectory:
    """The first plan: as `opt.solve`, but without a diagnosis, which would take seconds."""
    stays = refused(problem)
    if stays is not None:
        return stays
    return Search(problem).run(STRATEGIES if within_workspace(problem) else QUICK)
