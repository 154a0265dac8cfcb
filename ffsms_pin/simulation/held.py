"""A plan with rest after its end."""

from __future__ import annotations

from typing import Any

from ffsms_pin.opt import Trajectory


class Held:
    """A reference with a plan, followed by `hold` seconds at rest in the plan's final posture.

    `target` replaces the plan's target.
    """

    def __init__(self, plan: Trajectory, hold: float, target: Any = None) -> None:
        self.q, self.sample = plan.q, plan.sample
        self.target = plan.target if target is None else target
        # Without a problem, `simulate` judges only the distance to the target.
        self.problem = plan.problem if target is None else None
        self.momentum, self.base_mode = plan.momentum, plan.mode
        self.duration = plan.duration + hold
