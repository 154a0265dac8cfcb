"""Run a scenario: plan it, follow it in closed loop, keep what is needed to report both."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ffsms_pin import opt
from ffsms_pin.checks import instance, optional_callable
from ffsms_pin.control import JointLaw
from ffsms_pin.errors import InvalidScenario, numerical_errors
from ffsms_pin.files import check_writable, path_like
from ffsms_pin.identification import Identifier, compared
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.scenarios import closed_loop
from ffsms_pin.scenarios.closed_loop import Attempt, ClosedLoop, attempt, planned
from ffsms_pin.scenarios.definition import Scenario
from ffsms_pin.simulation import Guards, Tracking

if TYPE_CHECKING:
    from ffsms_pin.capture.recording import Captured

StageProgress = Callable[[str, float], None]


class Timing(NamedTuple):
    """The wall times of planning and tracking [s]."""

    planning: float
    tracking: float


@dataclass(frozen=True, eq=False)  # arrays have no single truth value to compare by
class Outcome:
    """The outcome of a scenario.

    Attributes
    ----------
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
    learnt : mapping, optional
        The bodies of [learn], believed, learnt and true (`identification.compared`).
    """

    scenario: Scenario
    sms: SpaceManipulator
    plant: SpaceManipulator
    controller: JointLaw
    trajectory: opt.Trajectory
    tracking: Tracking
    timing: Timing
    note: str = ""
    open_loop: Attempt | None = None
    capture: Captured | None = None
    learnt: Mapping[str, Any] | None = None

    @property
    def title(self) -> str:
        """The title of figures and tables: scenario, robot and method."""
        chosen = self.scenario
        return f"{chosen.name}: {chosen.robot['model']}, method '{chosen.plan.get('method', 'horizon')}'"


@numerical_errors("the scenario")
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
    progress : callable, optional
        Called with "planning", "tracking" or "plan once" and the share of that stage that is done, 0 to 1.
    folder : Path, optional
        Where the results will be: the file of [guards] counts from there. Default: the folder of the
        scenario's file.
    allow_outside : bool
        Whether the file of [guards] may lie elsewhere than below that folder.

    Raises
    ------
    InvalidScenario
        A value does not fit the robot, or a file lies outside the folder.
    ResultError
        The file of [guards] cannot be written; raised before anything is planned.
    FfsmsError
        The robot cannot be loaded, or the simulation does not stay finite.
    """
    check_call(scenario, progress)
    sms = scenario.load()
    with scenario.named():
        guarded = _guarded(scenario, folder, allow_outside)
        q0 = scenario.start_configuration(sms)
        law = closed_loop.controller(scenario, sms)
        loop = closed_loop.prepared(scenario, sms, q0)
        started = time.perf_counter()
        trajectory = planned(scenario, sms, q0, stage(progress, "planning"))
        ended = time.perf_counter()
        tracking, capture, note, learnt = flown(loop, trajectory, law, stage(progress, "tracking"), guarded)
        tracked, open_loop = time.perf_counter(), None
        if scenario.replans:
            report = stage(progress, "plan once")
            open_loop = attempt(partial(loop.run, loop.plan_once(trajectory), law, report))
    timing = Timing(ended - started, tracked - ended)
    return Outcome(
        scenario, sms, loop.plant, law, trajectory, tracking, timing, note, open_loop, capture, learnt
    )


class Flown(NamedTuple):
    """A followed plan: the recording up to the deadline, the capture, note and estimates of re-planning."""

    tracking: Tracking
    capture: Captured | None
    note: str
    learnt: Mapping[str, Any] | None = None


def flown(
    loop: ClosedLoop,
    plan: opt.Trajectory,
    law: JointLaw,
    progress: Callable[[float], None] | None = None,
    guards: Guards | None = None,
    once: bool = False,
) -> Flown:
    """Follow a plan under a law, or re-plan as the scenario does; if there is a client, catch it.

    `guards` stand in for those of the scenario; with `once` the plan is followed as it was made.
    """
    if loop.scenario.meet is not None:
        from ffsms_pin.scenarios.captures import fly_scenario  # most scenarios have no client

        flight = fly_scenario(loop, plan, progress, guards, once)
        return Flown(flight.captured.approach, flight.captured, flight.note)
    reference = loop.plan_once(plan) if once else loop.reference(plan)
    if isinstance(reference, opt.Replanning) and reference.learn is not None:
        reference.law = law
    tracking = loop.run(reference, law, progress, guards)
    law.sms = loop.sms
    if not isinstance(reference, opt.Replanning):
        return Flown(tracking, None, "")
    learnt = None
    if isinstance(reference.learn, Identifier):
        learnt = compared(reference.learn, loop.plant)
    return Flown(tracking, None, reference.note, learnt)


def check_call(scenario: Scenario, progress: StageProgress | None) -> None:
    """Raise `InvalidValue` unless this is a scenario, and a function to call or None."""
    instance("scenario", scenario, Scenario)
    optional_callable("progress", progress)


def stage(progress: StageProgress | None, name: str) -> Callable[[float], None] | None:
    """Report the beginning of a stage, and return the function that reports its progress."""
    if progress is None:
        return None
    progress(name, 0.0)
    return partial(progress, name)


def _guarded(scenario: Scenario, folder: Path | None, allow_outside: bool) -> Guards | None:
    """Return the guards that save the recording; None if they save nothing.

    The file counts from `folder`, by default that of the scenario. A `ResultError` tells before the run that
    it cannot be written.
    """
    name = scenario.guards.get("path")
    if name is None:
        return None
    folder = scenario.source.parent if folder is None else path_like("folder", folder)
    path = folder / name
    if not allow_outside and not Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder)):
        raise InvalidScenario(
            scenario.source,
            f"[guards] path = '{name}' lies outside the results folder {folder}: name a file below it, or "
            "allow it with allow_outside=True",
        )
    check_writable(path)
    return closed_loop.guards(scenario, path)
