"""Run a scenario: plan it, follow it in closed loop, keep what is needed to report both."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ffsms_pin import opt
from ffsms_pin.checks import instance, optional_callable
from ffsms_pin.control import JointLaw
from ffsms_pin.errors import InvalidScenario, numerical_errors
from ffsms_pin.files import check_writable, path_like
from ffsms_pin.scenarios import closed_loop
from ffsms_pin.scenarios.closed_loop import Attempt, ClosedLoop, attempt, planned
from ffsms_pin.scenarios.definition import Scenario
from ffsms_pin.scenarios.fits import OF_COMPLIANCE, OF_HANDLING
from ffsms_pin.scenarios.keys import radians
from ffsms_pin.scenarios.problems import client_bodies, guiding, meeting
from ffsms_pin.simulation import Reference, Tracking
from ffsms_pin.system import SpaceManipulator

if TYPE_CHECKING:
    from ffsms_pin.studies.capture import Captured

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
    trajectory: opt.Trajectory
    tracking: Tracking
    timing: Timing
    note: str = ""
    open_loop: Attempt | None = None
    capture: Captured | None = None


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
        reference = loop.reference(trajectory)
        tracking, capture = flown(loop, trajectory, reference, law, stage(progress, "tracking"), guarded)
        tracked = time.perf_counter()
        note, open_loop = "", None
        if scenario.replans and isinstance(reference, opt.Replanning):
            note = reference.note
            report = stage(progress, "plan once")
            open_loop = attempt(partial(loop.run, loop.plan_once(trajectory), law, report))
    timing = Timing(ended - started, tracked - ended)
    return Outcome(scenario, sms, loop.plant, law, trajectory, tracking, timing, note, open_loop, capture)


def flown(
    loop: ClosedLoop,
    plan: opt.Trajectory,
    reference: Reference,
    law: JointLaw,
    progress: Callable[[float], None] | None = None,
    files: Mapping[str, Any] | None = None,
) -> tuple[Tracking, Captured | None]:
    """Follow a plan's reference under a law; where there is a client, catch it under [contact].

    The recording up to the deadline, and what became of the client. `files` are options of `simulate`.
    """
    if loop.scenario.client is None:
        return loop.run(reference, law, progress, **(files or {})), None
    from ffsms_pin.contact import Grip  # most scenarios have no client
    from ffsms_pin.opt.limits.clearance.held import HeldClient
    from ffsms_pin.scenarios.replanning import Watching
    from ffsms_pin.studies.capture import captured
    from ffsms_pin.studies.handling import Handling
    from ffsms_pin.studies.knowledge import GoLimits
    from ffsms_pin.studies.masses import MassDoubt
    from ffsms_pin.studies.mission import Mission
    from ffsms_pin.studies.prediction import Envelope

    scenario, contact = loop.scenario, loop.scenario.contact
    client = scenario.made_client(loop.sms)
    known = reference.estimate if isinstance(reference, Watching) else scenario.known_client(loop.sms)
    meet = meeting(scenario.meet or {}, known)
    compliance = {key: contact[key] for key in OF_COMPLIANCE if key in contact}
    grip = Grip(meet.grasp, **compliance) if contact.get("kind") == "compliant" else None
    scene = guiding(scenario)
    given = {key: contact[key] for key in OF_HANDLING if key in contact}
    around = scenario.kept_clear(client)
    if around:
        shapes = [one for one in around if one.moves and one.piece_of is None]
        others = [one for one in around if not one.moves]
        given["room"] = partial(HeldClient, loop.sms, shapes, *scenario.clearance, obstacles=others)
    clearance, collision = scenario.clearance
    given |= {"obstacles": tuple(around), "clearance": clearance, "collision": collision}
    given["bodies"] = tuple(client_bodies(scenario, client))
    given["go"] = GoLimits(**radians(contact.get("go", {})))
    given["masses"] = MassDoubt(**_mass_doubt(scenario))
    options = {**loop.options, **(files or {})}
    envelope = Envelope(**radians(contact.get("envelope", {})))
    handling = Handling(envelope, grip, scene and scene.load, **given)

    def laws(robot: SpaceManipulator) -> Any:
        return closed_loop.controller(scenario, robot), closed_loop.base_law(scenario.attitude, robot)

    again = partial(scenario.problem, loop.sms)
    mission = Mission(loop.sms, loop.plant, plan, reference, meet, laws, handling, options["dt"], again)
    capture = captured(mission, client, options, progress)
    return capture.approach, capture


def _mass_doubt(scenario: Scenario) -> dict[str, float]:
    """Return what is not known of the servicer's masses: [contact.masses], by default what [plant] does."""
    plant = scenario.plant
    drawn = plant.get("random")
    shares = {} if drawn is None else {"arm": 0.2, "base": 0.1, "base_inertia": 0.1}  # its defaults
    if drawn is not None:
        names = {"arm": "arm_mass", "base": "base_mass", "base_inertia": "base_inertia"}
        shares = {name: drawn.get(key, shares[name]) for name, key in names.items()}
    even = {name: share / math.sqrt(3.0) for name, share in shares.items()}  # of an even distribution
    base = plant.get("base_mass", 1.0)
    set_to = {
        "arm": plant.get("arm_mass", 1.0),
        "base": base,
        "base_inertia": plant.get("base_inertia", base),
    }
    found = {
        name: math.hypot(even.get(name, 0.0), float(np.abs(np.asarray(value) - 1.0).max()))
        for name, value in set_to.items()
    }
    return found | dict(scenario.contact.get("masses", {}))


def check_call(scenario: Scenario, progress: StageProgress | None) -> None:
    """Raise `InvalidValue` unless this is a scenario, and a function to call or None."""
    instance("scenario", scenario, Scenario)
    optional_callable("progress", progress)


def stage(progress: StageProgress | None, name: str) -> Callable[[float], None] | None:
    """What reports the share done of one stage, by its name; it begins now."""
    if progress is None:
        return None
    progress(name, 0.0)
    return partial(progress, name)


def _guarded(scenario: Scenario, folder: Path | None, allow_outside: bool) -> dict[str, Any]:
    """Return the option of `simulate` for guards that save what was recorded; empty if they save nothing.

    The file counts from `folder`, by default that of the scenario. A `ResultError` tells before the run that
    it cannot be written.
    """
    name = scenario.guards.get("path")
    if name is None:
        return {}
    folder = scenario.source.parent if folder is None else path_like("folder", folder)
    path = folder / name
    if not allow_outside and not Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder)):
        raise InvalidScenario(
            scenario.source,
            f"[guards] path = '{name}' lies outside the results folder {folder}: name a file below it, or "
            "allow it with allow_outside=True",
        )
    check_writable(path)
    return {"guards": closed_loop.guards(scenario, path)}
