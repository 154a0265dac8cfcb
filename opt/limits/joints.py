"""The joints' rates, accelerations and positions as a limit."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, cast

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.limits.limit import Limit, Rows, Violation
from ffsms_pin.opt.motion.motions import Motions
from ffsms_pin.opt.motion.residual import Residuals
from ffsms_pin.opt.step.state import StepState
from ffsms_pin.system import JointLimits as Limits
from ffsms_pin.system import SpaceManipulator

__all__ = ["JointLimits"]

_ROUNDING = 1e-12  # [rad or rad/s] of sums over a thousand nodes
_BINDING = 1e-3  # share of a limit: with less than this left it binds


@dataclass(frozen=True)
class JointLimits(Limit):
    """The robot's own limits (`sms.limits`), at every instant and not only at nodes.

    In a step they are bounds on the joint rates; in a whole motion they are rows on the control points, which
    no solution breaks, so there is no residual.
    """

    name = "joints"
    joint_bounds: Limits | None = field(default=None, repr=False)

    def for_robot(self, sms: SpaceManipulator) -> JointLimits:
        """With the robot's limits."""
        return replace(self, joint_bounds=sms.limits)

    def rows(self, step: StepState) -> Rows:
        """Bounds on the joint rates that leave room to brake."""
        return Rows(self._each, *step.bounds)

    @cached_property
    def _each(self) -> FloatArray:
        """The identity (n, n), made once for all steps of a robot."""
        return np.eye(len(cast(Limits, self.joint_bounds).lower))

    def residual(self, motions: Motions) -> Residuals:
        """None: the control points keep the limits."""
        return []

    def violation(self, motion: Motions) -> Violation:
        """The largest excess of a joint's rate, acceleration or position, between instants too."""
        robot: Any = motion.stack.robot
        limits = robot.limits if self.joint_bounds is None else self.joint_bounds
        rates, steps = motion.rates[:, 0], np.diff(motion.times)
        accelerations = np.diff(rates, axis=1) / steps
        left = {
            "position": _room(motion.joints[:, 0], rates, accelerations, limits),
            "rate": limits.velocity[:, None] - np.abs(rates),
            "acceleration": limits.acceleration[:, None] - np.abs(accelerations),
        }
        wholes = limits.upper - limits.lower, limits.velocity, limits.acceleration
        rounding = _ROUNDING, _ROUNDING, _ROUNDING / float(steps.min())
        units = ("rad", "rad/s", "rad/s^2")
        amount, notes, binds = 0.0, [], np.zeros(len(motion.times), dtype=bool)
        for (kind, room), whole, least, unit in zip(left.items(), wholes, rounding, units, strict=True):
            near = room < _BINDING * np.where(np.isfinite(whole), whole, 1.0)[:, None]
            binds[: room.shape[1]] |= near.any(axis=0)
            joint, k = np.unravel_index(int(np.argmin(room)), room.shape)
            worst = -float(room[joint, k])
            if worst > least:
                amount = max(amount, worst)
                notes.append(
                    f"the {kind} limit of '{robot.joint_names[joint]}' is broken by {worst:.3g} {unit} "
                    f"at {motion.times[k]:.3g} s"
                )
        return Violation(amount, motion.times[binds], "; ".join(notes))


def _room(joints: FloatArray, rates: FloatArray, accelerations: FloatArray, limits: Limits) -> FloatArray:
    """What is left of the positions (n, K), at each instant and where a joint turns before the next."""
    start, end = rates[:, :-1], rates[:, 1:]
    turns = start * end < 0.0
    turned = joints.copy()
    turned[:, :-1] -= np.where(turns, start**2 / (2.0 * np.where(turns, accelerations, 1.0)), 0.0)
    both = np.stack([joints, turned])
    left: FloatArray = np.minimum(both - limits.lower[:, None], limits.upper[:, None] - both).min(axis=0)
    return left
