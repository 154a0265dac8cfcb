"""Define custom terms and limits outside the package, as docs/own-parts.md describes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ffsms_pin import opt
from ffsms_pin.opt.evaluation import UNBOUNDED
from ffsms_pin.opt.rollouts import Rollouts
from ffsms_pin.opt.step.state import StepState

__all__ = ["AbovePlane", "Below", "LookAt"]


@dataclass(frozen=True)
class LookAt(opt.Term):
    """A penalty on the angle between the end effector's x axis and the direction to a point.

    Attributes
    ----------
    point : tuple of float
        The point in inertial axes [m].
    weight : float
        The weight of the integral of 1 - cos(angle) [1/s].
    """

    point: tuple[float, float, float]
    weight: float = 0.1
    name = "look at"

    def residual(self, m: opt.Variables) -> Any:
        """Return sqrt(weight / 2) (axis - direction), whose square is weight (1 - cos)."""
        direction = self.point - m.tip
        return np.sqrt(0.5 * self.weight) * (m.tip.axis([1.0, 0.0, 0.0]) - direction / direction.norm())


@dataclass(frozen=True)
class AbovePlane(opt.Limit):
    """A half-space in which the end effector must stay.

    Attributes
    ----------
    normal : tuple of float
        The unit vector to the allowed side, inertial axes.
    offset : float
        The offset of the plane along the normal [m].
    """

    normal: tuple[float, float, float]
    offset: float
    name = "plane"
    margin = 0.005  # [arm lengths]

    def rows(self, step: StepState) -> opt.Rows:
        """Return a row that limits the rate of descent in proportion to the height."""
        normal = np.array(self.normal)
        height = float(normal @ step.pose.translation) - self.offset
        drifting = float(normal @ step.tip_drift[:3])
        least = 2.0 * (2e-3 - height) - drifting
        return opt.Rows(
            (normal @ step.J_star[:3])[None], np.array([least]), np.array([UNBOUNDED]), softness=1.0
        )

    def residual(self, m: opt.Variables) -> Any:
        """Return the violation of the margin in arm lengths."""
        height = m.tip.dot(self.normal) - self.offset
        return np.maximum(self.margin - height / m.stack.length, 0.0)

    def violation(self, motion: Rollouts) -> opt.Violation:
        """Return the largest depth below the plane [m]."""
        height = np.array(self.normal) @ motion.end_effector[:, 0] - self.offset
        amount = max(0.0, -float(height.min()))
        note = f"the end effector is {1e3 * amount:.1f} mm below the plane" if amount else ""
        return opt.Violation(amount, motion.times[height < 1e-3], note)


class Below(opt.Inequality):
    """An upper limit on the height of the end effector [m]."""

    name = "ceiling"

    def __init__(self, height: float) -> None:
        self.height = height

    def slack(self, m: opt.Variables) -> opt.Variable:
        slack: opt.Variable = self.height - m.tip[2]
        return slack
