"""Run a scenario: plan it, follow it in closed loop, keep what is needed to report both."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

from ffsms_pin.checks import instance, optional_callable
from ffsms_pin.control import JointLaw
from ffsms_pin.opt import Replanning, Trajectory
from ffsms_pin.scenarios.capture import Captured, captured
from ffsms_pin.scenarios.closed_loop import Attempt, attempt, named, prepared
from ffsms_pin.scenarios.conditions import controller
from ffsms_pin.scenarios.definition import Scenario
from ffsms_pin.scenarios.own_files import expected_size, own_files
from ffsms_pin.scenarios.references import planned
from ffsms_pin.simulation import Tracking
from ffsms_pin.storage import path_like, require_space
from ffsms_pin.system import SpaceManipulator

__all__ = ["Outcome", "StageProgress", "Timing", "check_call", "run", "stage"]

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
        The model, that plan and controller know.
    plant : SpaceManipulator
        What was simulated.
    controller : JointLaw
    trajectory : Trajectory
        The plan.
    tracking : Tracking
        The closed loop: the plan followed, or a motion that was planned again on the way.
    timing : Timing
    note : str
        What stood in the way of planning again, as the reference says; else empty.
    open_loop : Attempt, optional
        Where the motion was planned again: the plan made once, followed under the same conditions.
    capture : Captured, optional
        What became of a client that was to be met.
    """

    scenario: Scenario
    sms: SpaceManipulator
    plant: SpaceManipulator
    controller: JointLaw
    trajectory: Trajectory
    tracking: Tracking
    timing: Timing
    note: str = ""
    open_loop: Attempt | None = None
    capture: Captured | None = None


def run(
    scenario: Scenario,
    progress: StageProgress | None = None,
    *,
    folder: Path | None = None,
    allow_outside: bool = False,
) -> Outcome:
    """Plan the scenario's motion and follow it in closed loop, under the scenario's conditions.

    A target that is not reached is no error: `outcome.trajectory.reached` says so of the plan.

    Parameters
    ----------
    scenario : Scenario
    progress : callable, optional
        Called with "planning", "tracking" or "plan once" and the share of that stage that is done, 0 to 1.
    folder : Path, optional
        Where the results will be: it must have room for them, and the files that the scenario names count
        from there. Default: the folder of the scenario's file.
    allow_outside : bool
        Whether files that the scenario names may lie elsewhere than below that folder.

    Raises
    ------
    InvalidScenario
        A value does not fit the robot, or a file lies outside the folder.
    ResultError
        A file cannot be written, or there is no room for the results; found out before anything is planned.
    FfsmsError
        The robot cannot be loaded, the simulation does not stay finite, or its watchdog stops it.
    """
    check_call(scenario, progress)
    sms = scenario.load()
    if folder is not None:
        require_space(path_like("folder", folder), expected_size(scenario, sms))
    with named(scenario):
        files = own_files(scenario, folder, allow_outside)
        q0 = scenario.start_configuration(sms)
        law = controller(scenario, sms)
        loop = prepared(scenario, sms, q0)
        started = time.perf_counter()
        trajectory = planned(scenario, sms, q0, stage(progress, "planning"))
        ended = time.perf_counter()
        reference = loop.reference(trajectory)
        tracking = loop.run(reference, law, stage(progress, "tracking"), **files)
        tracked = time.perf_counter()
        note, open_loop, capture = "", None, None
        if isinstance(reference, Replanning):
            note = reference.note
            open_loop = attempt(
                partial(loop.run, loop.plan_once(trajectory), law, stage(progress, "plan once"))
            )
        if scenario.client is not None:
            capture = captured(scenario, sms, trajectory, tracking, loop.options, stage(progress, "capture"))
    return Outcome(
        scenario,
        sms,
        loop.plant,
        law,
        trajectory,
        tracking,
        Timing(ended - started, tracked - ended),
        note,
        open_loop,
        capture,
    )


def check_call(scenario: Scenario, progress: StageProgress | None) -> None:
    """Raise `InvalidValue` unless this is a scenario, and a function to call or None."""
    instance("scenario", scenario, Scenario)
    optional_callable("progress", progress)


def stage(progress: StageProgress | None, name: str) -> Callable[[float], None] | None:
    """What reports the share done of one stage, by its name."""
    return None if progress is None else lambda share: progress(name, share)
