"""A plan with rest after its end."""

from __future__ import annotations

from typing import Any

from ffsms_pin.opt import Trajectory


class Held:
    """A plan followed by `hold` seconds in its final state, at rest.

    Position errors are measured to `target`, by default the plan's target.
    """

    def __init__(self, plan: Trajectory, hold: float, target: Any = None) -> None:
        self.q, self.sample = plan.q, plan.sample
        self.target = plan.target if target is None else target
        self.problem = plan.problem if target is None else None  # another target is judged on its own
        self.momentum, self.base_mode = plan.momentum, plan.mode
        self.duration = plan.duration + hold
