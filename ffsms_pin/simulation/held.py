"""A planned reference that stays at rest after its end."""

from __future__ import annotations

from typing import Any

from ffsms_pin.opt import Trajectory


class Held:
    """A reference that follows a plan and then rests for `hold` [s] in the plan's final posture.

    `target`, if it is not None, replaces the plan's target.
    """

    def __init__(self, plan: Trajectory, hold: float, target: Any = None) -> None:
        self.q, self.sample = plan.q, plan.sample
        self.target = plan.target if target is None else target
        # Without a problem, `simulate` judges only the final error to the target.
        self.problem = plan.problem if target is None else None
        self.momentum, self.base_mode = plan.momentum, plan.mode
        self.duration = plan.duration + hold
