"""The joints' rates, accelerations and positions as a limit."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.limits.limit import Limit, Rows, Violation
from ffsms_pin.opt.limits.rate_bounds import RateBounds
from ffsms_pin.opt.limits.step_state import StepState
from ffsms_pin.opt.motion.motions import Motions
from ffsms_pin.opt.motion.residual import Residuals
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
    _joint_names: tuple[str, ...] = field(default=(), repr=False)
    _bounds: RateBounds | None = field(default=None, repr=False, compare=False)

    def for_robot(self, sms: SpaceManipulator) -> JointLimits:
        """With the robot's limits."""
        return replace(
            self,
            joint_bounds=sms.limits,
            _joint_names=tuple(sms.joint_names),
            _bounds=RateBounds(sms.limits),
        )

    @property
    def limits(self) -> Limits:
        """The robot's limits."""
        if self.joint_bounds is None:
            raise ValueError("JointLimits.for_robot comes first")
        return self.joint_bounds

    def rows(self, step: StepState) -> Rows:
        """Bounds on the joint rates that leave room to brake."""
        if self._bounds is None:
            raise ValueError("JointLimits.for_robot comes first")
        return self._bounds.rows(step.joints, step.rates, step.dt)

    def residual(self, motions: Motions) -> Residuals:
        """None: the control points keep the limits."""
        return []

    def violation(self, motion: Motions) -> Violation:
        """The largest excess of a joint's rate, acceleration or position, between nodes too."""
        limits = self.limits
        joints, rates = motion.joints[:, 0], motion.rates[:, 0]
        accelerations = np.diff(rates, axis=1) / np.diff(motion.times)
        # Between two instants a position has its extreme where the rate changes sign.
        start, end = rates[:, :-1], rates[:, 1:]
        turning = start * end < 0.0
        extremes = joints[:, :-1] - np.where(
            turning, start**2 / (2.0 * np.where(turning, accelerations, 1.0)), 0.0
        )
        extremes = np.hstack([extremes, joints[:, -1:]])
        beyond = np.maximum(
            np.maximum(limits.lower[:, None] - joints, joints - limits.upper[:, None]),
            np.maximum(limits.lower[:, None] - extremes, extremes - limits.upper[:, None]),
        )
        fast = np.abs(rates) - limits.velocity[:, None]
        hard = np.hstack([np.abs(accelerations), np.zeros((len(joints), 1))]) - limits.acceleration[:, None]
        rounding = (_ROUNDING, _ROUNDING, _ROUNDING / float(np.diff(motion.times).min()))
        kinds = zip(
            ("position", "rate", "acceleration"),
            (beyond, fast, hard),
            rounding,
            ("rad", "rad/s", "rad/s^2"),
            strict=True,
        )
        amount, notes = 0.0, []
        for kind, excess, least, unit in kinds:
            joint, k = np.unravel_index(int(np.argmax(excess)), excess.shape)
            worst = float(excess[joint, k])
            if worst > least:
                amount = max(amount, worst)
                notes.append(
                    f"the {kind} limit of '{self._joint_names[joint]}' is broken by {worst:.3g} {unit} "
                    f"at {motion.times[k]:.3g} s"
                )
        return Violation(amount, motion.times[self._binds(joints, fast, hard)], "; ".join(notes))

    def _binds(self, joints: FloatArray, fast: FloatArray, hard: FloatArray) -> FloatArray:
        """Whether any joint is at a limit, at every instant."""
        limits = self.limits
        span = np.where(np.isfinite(limits.upper - limits.lower), limits.upper - limits.lower, 1.0)
        near = (
            np.minimum(joints - limits.lower[:, None], limits.upper[:, None] - joints)
            < _BINDING * span[:, None]
        )
        near |= fast > -_BINDING * np.minimum(limits.velocity, 1e9)[:, None]
        near |= hard > -_BINDING * np.minimum(limits.acceleration, 1e9)[:, None]
        return np.asarray(near.any(axis=0))
