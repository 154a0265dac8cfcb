"""What the closed loop is to follow: the scenario's plan, or a motion that is planned again in the loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt import Replanning, StepPlanner, Trajectory
from ffsms_pin.scenarios.conditions import radians
from ffsms_pin.scenarios.definition import Scenario
from ffsms_pin.system import SpaceManipulator

__all__ = ["Held", "planned", "replanning"]

# Of [plan], what a step in the loop is planned with as well.
_SHARED = ("kappa", "clearance", "collision", "base_limits", "momentum")


def planned(
    scenario: Scenario,
    sms: SpaceManipulator,
    q0: FloatArray,
    progress: Callable[[float], None] | None,
    method: str | None = None,
) -> Trajectory:
    """The scenario's plan from q0; `method` stands in for the scenario's own."""
    options = _options(scenario)
    if method is not None:
        options["method"] = method
    trajectory = opt.plan(sms, q0, scenario.target["position"], progress=progress, **options)
    # r_th judges a plan; it does not steer it.
    return replace(trajectory, reach=scenario.plan.get("reach", trajectory.reach))


def replanning(scenario: Scenario, sms: SpaceManipulator) -> Replanning:
    """A reference that plans again from the measured state; one run uses it up."""
    options = {key: value for key, value in _options(scenario).items() if key in _SHARED}
    dt = scenario.reference.get("dt", scenario.plan.get("dt", 0.01))
    planner = StepPlanner(sms, dt=dt, **options)
    return planner.track(scenario.target["position"], scenario.arrival, scenario.reference.get("hold", 0.0))


def _options(scenario: Scenario) -> dict[str, Any]:
    """What [plan] says, as `opt.plan` takes it."""
    options = {key: value for key, value in scenario.plan.items() if key != "reach"}
    if "base_limits" in options:
        options["base_limits"] = opt.BaseLimits(**radians(options["base_limits"]))
    return options


class Held:
    """A plan made once, and after its end the rest that it ends in.

    Parameters
    ----------
    plan : Trajectory
    hold : float
        How much longer than the plan this lasts [s].
    """

    def __init__(self, plan: Trajectory, hold: float) -> None:
        self.q, self.target, self.sample = plan.q, plan.target, plan.sample
        self.duration = plan.duration + hold
