"""Steps along a path from measured states: resolved rates with the estimated robot, near a planned motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.goals.goal import frame_at
from ffsms_pin.opt.goals.path import Path
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.replan.options import ReplanOptions
from ffsms_pin.opt.replan.rest import JointPlan
from ffsms_pin.opt.search.path_following import PathNodes, feedback_gain, path_task, plan_along, resolved
from ffsms_pin.opt.step.stepper import StepWeights
from ffsms_pin.opt.trajectory import Trajectory
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.robot.base_motion import advance

_NOISY_GAIN = 2.0  # [1/s] the feedback gain for noisy measurements
_ANOTHER = 5e-3  # [m, rad] if the measured start pose deviates by more, it replaces the problem's start
_APPROACH = 1.0  # [1/s] the largest rate of a joint towards a position limit, per distance to the limit
_RETURN = 2.0  # [1/s] the gain of redundant motion towards the plan


def check_options(options: ReplanOptions, weights: StepWeights | None) -> None:
    """Raise `InvalidValue` for options and weights that steps along a path do not support."""
    for name in ("search_again", "dead_band", "settle", "rate_reserve"):
        if (value := getattr(options, name)) != getattr(ReplanOptions, name):
            remedy = "is not for an opt.Path, which is followed by resolved rates at all times; leave it out"
            raise InvalidValue(name, value, remedy)
    if weights is not None:
        remedy = "must be left out for an opt.Path, because its steps do not solve a weighted QP"
        raise InvalidValue("weights", weights, remedy)


class PathTracker:
    """A tracker that keeps the measured end effector on a path within the joint limits.

    The tracker uses resolved-rate control with the J* of the estimated robot; feedback compensates errors of
    the masses. Redundant motion follows a planned motion, which keeps the clearance. The path is evaluated in
    every step, so a path on a client moves with the newest estimate of the client.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        assert isinstance(problem.goal, Path)
        if problem.goal.timing == "fastest" and problem.goal.law is None:
            remedy = (
                "must be planned before re-planning: plan = opt.solve(problem), and then "
                "opt.Replanning(plan.problem, plan=plan)"
            )
            raise InvalidValue("timing", problem.goal.timing, remedy)

    def begun(self, q: FloatArray) -> Problem:
        """Return the problem, with the start at the measured q (nq,) if its end-effector pose deviates.

        Deviations up to `_ANOTHER` are taken as noise. Joints are clipped to their position limits.
        """
        place = frame_at(self._problem.sms.at(self._problem.q0).end_effector_pose)
        here = self._problem.sms.at(q).end_effector_pose
        distance = float(np.linalg.norm(place.value[:, 0, 0] - here.translation))
        turn = float(np.linalg.norm(pin.log3(place.rotation[..., 0, 0].T @ here.rotation)))
        if distance > _ANOTHER or turn > _ANOTHER:
            self._problem = replace(self._problem, q0=self._within_limits(q))
        return self._problem

    def plan(self, q: FloatArray, trajectory: Trajectory | None) -> JointPlan:
        """Return the first plan, from `trajectory` or, if it is None, planned from the measured q (nq,)."""
        if trajectory is None:
            trajectory = plan_along(replace(self._problem, q0=self._within_limits(q)))
        return JointPlan.of_trajectory(trajectory)

    def _within_limits(self, q: FloatArray) -> FloatArray:
        """Return q with joints clipped to their position limits, which measurements may exceed by noise."""
        sms, q = self._problem.sms, q.copy()
        sms.layout.set_positions(q, np.clip(sms.layout.positions(q), sms.limits.lower, sms.limits.upper))
        return q

    def use(self, robot: SpaceManipulator, momentum: FloatArray | None) -> None:
        """Use another estimate of the robot and its total momentum (6,) from the next step on."""
        self._problem = replace(self._problem, sms=robot, momentum=momentum)

    def rates(
        self,
        step: int,
        q: FloatArray,
        plan: JointPlan,
        command: tuple[FloatArray, FloatArray, FloatArray],
        fixed: NDArray[np.bool_],
        noisy: bool,
    ) -> FloatArray:
        """Return joint rates (n,) for the end of a step that begins at node `step` in the measured q (nq,).

        `command` has the commanded joint positions, rates and accelerations (n,). `fixed` (n,) is the mask of
        joints that do not move. With `noisy` measurements the feedback gain is lower.
        """
        problem, dt = self._problem, self._problem.dt
        joints, rates, accelerations = command
        sms = problem.sms
        ahead, _ = advance(sms, q, rates, accelerations, dt, problem.momentum, problem.mode)
        node = PathNodes.of(problem.goal, np.array([(step + 1) * dt]))
        gain = feedback_gain(dt, _NOISY_GAIN) if noisy else feedback_gain(dt)
        task = path_task(problem, node, 0, ahead, sms.layout.positions(ahead), gain)
        planned_joints, planned_rates = plan.sample((step + 1) * dt)
        prefer = planned_rates + _RETURN * (planned_joints - joints - dt * rates)
        least, greatest = kernel.rate_bounds(sms.limits.table, joints, rates, dt)
        # Joints slow down near a position limit, because a joint that lags behind the command could pass the
        # limit.
        limits, here = sms.limits, sms.layout.difference(q, joints) + joints
        least = np.minimum(np.maximum(least, _APPROACH * np.minimum(limits.lower - here, 0.0)), greatest)
        greatest = np.maximum(np.minimum(greatest, _APPROACH * np.maximum(limits.upper - here, 0.0)), least)
        least, greatest = np.where(fixed, 0.0, least), np.where(fixed, 0.0, greatest)
        return resolved(task, np.where(fixed, 0.0, prefer), (least, greatest))
