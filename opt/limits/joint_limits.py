"""The limits of joint positions, rates and accelerations."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ffsms_pin.opt.derivatives import Variable
from ffsms_pin.opt.evaluation import Rows, Violation
from ffsms_pin.opt.limits.limit import POSITION_MARGIN, RATE_MARGIN, Limit, SpeedBound
from ffsms_pin.opt.rollouts import RecordedRollouts, Rollouts
from ffsms_pin.opt.step.state import StepState
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system import RobotLimits


@dataclass(frozen=True)
class JointLimits(Limit):
    """The limits of joint positions, rates and accelerations (`sms.limits`) at every instant.

    In a step the limits are bounds on the joint rates. In a whole motion they are hard constraints on the
    control points of the spline, so the residual is empty.
    """

    name = "joints"
    joint_bounds: RobotLimits | None = field(default=None, repr=False)

    def for_robot(self, sms: SpaceManipulator) -> JointLimits:
        """Return the limit with the bounds of a robot, `sms.limits`."""
        return replace(self, joint_bounds=sms.limits)

    def rows(self, step: StepState) -> Rows:
        """Return bounds on the joint rates, with which each joint can stop before its position limit."""
        return Rows(np.eye(step.sms.n), *step.bounds)

    def residual(self, motions: Rollouts) -> list[Variable]:
        """Return no residual, because constraints on the control points ensure the limits."""
        return []

    def violation(self, motion: Rollouts) -> Violation:
        """Return the largest excess of a joint's rate, acceleration or position, also between instants."""
        robot: Any = motion.stack.robot
        limits = robot.limits if self.joint_bounds is None else self.joint_bounds
        joints, rates, steps = motion.joints[:, 0], motion.rates[:, 0], np.diff(motion.times)
        accelerations = np.diff(rates, axis=1) / steps
        # If a joint reverses between two instants, its extreme position is between them.
        both, turns = np.stack([joints, joints]), rates[:, :-1] * rates[:, 1:] < 0.0
        both[1, :, :-1][turns] -= rates[:, :-1][turns] ** 2 / (2.0 * accelerations[turns])
        left = np.minimum(both - limits.lower[:, None], limits.upper[:, None] - both).min(axis=0)
        faster = limits.velocity[:, None] - np.abs(rates)
        harder = limits.acceleration[:, None] - np.abs(accelerations)
        rounding = 1e-12  # rounding error of sums over a thousand nodes
        kinds = (
            ("position", left, limits.upper - limits.lower, "", rounding),
            ("rate", faster, limits.velocity, "/s", rounding),
            ("acceleration", harder, limits.acceleration, "/s^2", rounding / float(steps.min())),
        )
        amount, notes, binds = 0.0, [], np.zeros(len(motion.times), dtype=bool)
        for kind, slack, whole, per_time, least in kinds:
            near = slack < 1e-3 * np.where(np.isfinite(whole), whole, 1.0)[:, None]
            binds[: slack.shape[1]] |= near.any(axis=0)
            joint, k = np.unravel_index(int(np.argmin(slack)), slack.shape)
            worst = -float(slack[joint, k])
            if worst > least:
                unit = "rad" if robot.layout.turns[joint] else "m"
                amount, by = max(amount, worst), f"{worst:.3g} {unit}{per_time} at {motion.times[k]:.3g} s"
                notes.append(f"the {kind} limit of '{robot.joint_names[joint]}' is violated by {by}")
        return Violation(amount, motion.times[binds], "; ".join(notes))

    def speed_bound(self, motion: Rollouts) -> SpeedBound:
        """Return the bounds on the speed along a path from the joints' rate and acceleration limits."""
        robot: Any = motion.stack.robot
        limits = robot.limits if self.joint_bounds is None else self.joint_bounds
        still = np.zeros(len(limits.velocity))
        return SpeedBound(still, motion.rates[:, 0], limits.velocity, limits.acceleration)

    def violation_in_flight(self, motion: RecordedRollouts) -> Violation:
        """Return the largest excess of a position or rate, zero within `POSITION_MARGIN` and `RATE_MARGIN`.

        Accelerations are not checked, because a control law may exceed their limits to correct small errors.
        """
        robot: Any = motion.stack.robot
        limits = robot.limits if self.joint_bounds is None else self.joint_bounds
        joints, rates = motion.joints[:, 0], np.abs(motion.rates[:, 0])
        beyond = np.maximum(limits.lower[:, None] - joints, joints - limits.upper[:, None])
        kinds = (
            ("position", beyond, POSITION_MARGIN, ""),
            ("rate", rates - limits.velocity[:, None], RATE_MARGIN * limits.velocity[:, None], "/s"),
        )
        amount, notes = 0.0, []
        for kind, excess, margin, per_second in kinds:
            joint, k = np.unravel_index(int(np.argmax(excess - margin)), excess.shape)
            if (excess - margin)[joint, k] > 0.0:
                worst, unit = float(excess[joint, k]), "rad" if robot.layout.turns[joint] else "m"
                amount, by = max(amount, worst), f"{worst:.3g} {unit}{per_second} at {motion.times[k]:.3g} s"
                notes.append(f"the {kind} limit of '{robot.joint_names[joint]}' is violated by {by}")
        return Violation(amount, note="; ".join(notes))
