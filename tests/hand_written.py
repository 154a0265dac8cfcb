"""Define a limit by its own rows, residual and violation, for comparison with an `opt.Inequality`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ffsms_pin import opt
from ffsms_pin.checks import FloatArray

__all__ = ["Above"]


@dataclass(frozen=True)
class Above(opt.Limit):
    """A minimum height of the end effector over a plane through the origin: normal . position >= height."""

    normal: tuple[float, float, float]  # unit vector, inertial axes
    height: float = 0.0  # [m]
    name = "above"
    margin = 0.01  # [arm lengths]

    def over(self, position: FloatArray) -> FloatArray:
        return np.tensordot(self.normal, position, axes=1) - self.height

    def rows(self, step: Any) -> opt.Rows:
        G = np.array(self.normal) @ step.J_star[:3]
        drifting = np.array(self.normal) @ step.tip_drift[:3]
        left = self.over(step.pose.translation) - 0.002
        least = -2.0 * left - drifting
        return opt.Rows(G[None], np.array([least]), np.array([opt.UNBOUNDED]), softness=1.0)

    def residual(self, m: opt.Variables) -> Any:
        over = m.tip.dot(self.normal) - self.height
        return np.maximum(self.margin + (m.extra_margin - over) / m.stack.length, 0.0)

    def violation(self, motion: opt.Rollouts) -> opt.Violation:
        over = self.over(motion.end_effector)[0]
        k = int(np.argmin(over))
        near = motion.times[over < 1e-3]
        if over[k] > -1e-6:
            return opt.Violation(0.0, near)
        note = f"the end effector is {-1e3 * over[k]:.2f} mm below the plane at {motion.times[k]:.3g} s"
        return opt.Violation(-over[k], near, note)
