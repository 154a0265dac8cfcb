"""References that rest: at the start of a motion that is not planned yet, and after the end of a plan."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt import Trajectory


class Rest(NamedTuple):
    """A reference that stays where it starts: it stands in for a motion that is not planned yet."""

    duration: float
    target: ArrayLike
    positions: FloatArray

    def sample(self, t: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the joint positions, and zero rates and accelerations."""
        return self.positions, np.zeros_like(self.positions), np.zeros_like(self.positions)


class Held:
    """A plan made once, and for `hold` [s] after its end the rest that it ends in.

    `target` is what an end effector may miss, by default the plan's.
    """

    def __init__(self, plan: Trajectory, hold: float, target: Any = None) -> None:
        self.q, self.sample = plan.q, plan.sample
        self.target = plan.target if target is None else target
        self.problem = plan.problem if target is None else None  # another target has a verdict of its own
        self.momentum, self.base_mode = plan.momentum, plan.mode
        self.duration = plan.duration + hold
