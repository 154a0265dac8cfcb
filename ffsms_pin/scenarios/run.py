"""Run a scenario: plan it, track the plan, keep what is needed to report both."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

from ffsms_pin.checks import FloatArray
from ffsms_pin.control import SlidingModeController
from ffsms_pin.errors import InvalidScenario, InvalidValue
from ffsms_pin.opt import Trajectory, plan
from ffsms_pin.scenarios.definition import Scenario
from ffsms_pin.simulation import Tracking, simulate
from ffsms_pin.system import SpaceManipulator

__all__ = ["Outcome", "Timing", "planned", "run", "stage"]

StageProgress = Callable[[str, float], None]


class Timing(NamedTuple):
    """Wall times [s]."""

    planning: float
    tracking: float


@dataclass(frozen=True, eq=False)  # arrays have no single truth value to compare by
class Outcome:
    """What a scenario gave.

    Attributes
    ----------
    scenario : Scenario
    sms : SpaceManipulator
    controller : SlidingModeController
    trajectory : Trajectory
        The plan.
    tracking : Tracking
        The plan, followed in closed loop.
    timing : Timing
    """

    scenario: Scenario
    sms: SpaceManipulator
    controller: SlidingModeController
    trajectory: Trajectory
    tracking: Tracking
    timing: Timing


def run(scenario: Scenario, progress: StageProgress | None = None) -> Outcome:
    """Plan the scenario's motion and track it in closed loop.

    A target that is not reached is no error: `outcome.trajectory.reached` says so.

    Parameters
    ----------
    scenario : Scenario
    progress : callable, optional
        Called with "planning" or "tracking" and the share of that stage that is done, 0 to 1.

    Raises
    ------
    InvalidScenario
        A value does not fit the robot.
    FfsmsError
        The robot cannot be loaded, or the simulation does not stay finite.
    """
    sms = scenario.load()
    try:
        q0 = scenario.start_configuration(sms)
        plant_q0 = scenario.plant_start(sms, q0)
        controller = _controller(scenario, sms)
        started = time.perf_counter()
        trajectory = planned(scenario, sms, q0, stage(progress, "planning"))
        ended = time.perf_counter()
        tracking = simulate(
            sms,
            trajectory,
            controller,
            q0=plant_q0,
            progress=stage(progress, "tracking"),
            **{key: scenario.control[key] for key in ("dt",) if key in scenario.control},
        )
    except InvalidValue as error:
        raise InvalidScenario(scenario.source, str(error)) from None
    tracked = time.perf_counter()
    timing = Timing(ended - started, tracked - ended)
    return Outcome(scenario, sms, controller, trajectory, tracking, timing)


def planned(
    scenario: Scenario,
    sms: SpaceManipulator,
    q0: FloatArray,
    progress: Callable[[float], None] | None,
    method: str | None = None,
) -> Trajectory:
    """The scenario's plan from q0; `method` stands in for the scenario's own."""
    options = {key: value for key, value in scenario.plan.items() if key != "reach"}
    if method is not None:
        options["method"] = method
    trajectory = plan(sms, q0, scenario.target["position"], progress=progress, **options)
    # r_th judges a plan; it does not steer it.
    return replace(trajectory, reach=scenario.plan.get("reach", trajectory.reach))


def _controller(scenario: Scenario, sms: SpaceManipulator) -> SlidingModeController:
    given = scenario.control
    gains = {key: given[key] for key in ("K_s", "Gamma", "boundary") if key in given}
    torque_limit = scenario.per_joint(sms, "control", "torque_limit")
    if torque_limit is not None:
        gains["torque_limit"] = torque_limit
    return SlidingModeController(sms, **gains)


def stage(progress: StageProgress | None, name: str) -> Callable[[float], None] | None:
    """What reports the share done of one stage, by its name."""
    return None if progress is None else lambda share: progress(name, share)
