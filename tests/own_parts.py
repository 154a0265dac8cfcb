"""A term and a limit of one's own, as docs/own-parts.md says: outside of the package, from public names."""

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
    """The camera at the end effector looks at a point: its x axis points there.

    Attributes
    ----------
    point : tuple of float
        Inertial axes [m].
    weight : float
        On the integral of 1 - cos(angle) [1/s].
    """

    point: tuple[float, float, float]
    weight: float = 0.1
    name = "look at"

    def residual(self, m: opt.Variables) -> Any:
        """sqrt(weight) |axis - direction to the point| / sqrt(2): squared, the weight times 1 - cos."""
        way = self.point - m.tip
        return np.sqrt(0.5 * self.weight) * (m.tip.axis([1.0, 0.0, 0.0]) - way / way.norm())


@dataclass(frozen=True)
class AbovePlane(opt.Limit):
    """The end effector stays on one side of a plane.

    Attributes
    ----------
    normal : tuple of float
        Unit vector to the allowed side, inertial axes.
    offset : float
        Of the plane, along the normal [m].
    """

    normal: tuple[float, float, float]
    offset: float
    name = "plane"
    margin = 0.005  # [arm lengths]

    def rows(self, step: StepState) -> opt.Rows:
        """The height may shrink at most at a rate proportional to what is left of it."""
        normal = np.array(self.normal)
        height = float(normal @ step.pose.translation) - self.offset
        drifting = float(normal @ step.tip_drift[:3])
        least = 2.0 * (2e-3 - height) - drifting
        return opt.Rows(
            (normal @ step.J_star[:3])[None], np.array([least]), np.array([UNBOUNDED]), softness=1.0
        )

    def residual(self, m: opt.Variables) -> Any:
        """What the height lacks, in arm lengths."""
        height = m.tip.dot(self.normal) - self.offset
        return np.maximum(self.margin - height / m.stack.length, 0.0)

    def violation(self, motion: Rollouts) -> opt.Violation:
        """The largest depth below the plane [m]."""
        height = np.array(self.normal) @ motion.end_effector[:, 0] - self.offset
        amount = max(0.0, -float(height.min()))
        note = f"the end effector is {1e3 * amount:.1f} mm below the plane" if amount else ""
        return opt.Violation(amount, motion.times[height < 1e-3], note)


class Below(opt.Inequality):
    """The end effector stays below a height [m]."""

    name = "ceiling"

    def __init__(self, height: float) -> None:
        self.height = height

    def slack(self, m: opt.Variables) -> opt.Variable:
        slack: opt.Variable = self.height - m.tip[2]
        return slack
