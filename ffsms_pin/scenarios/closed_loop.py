"""The run of a scenario: control laws, conditions, plan, and closed loop."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin import capture, opt
from ffsms_pin.capture.recording import Captured
from ffsms_pin.capture.visual_replanning import with_client
from ffsms_pin.checks import FloatArray, instance, optional_callable
from ffsms_pin.control import LAWS, BaseLaw, Coordinated, JointLaw, MomentumDump
from ffsms_pin.errors import InvalidScenario, SimulationDiverged, numerical_errors
from ffsms_pin.files import check_writable, path_like
from ffsms_pin.identification import Identifier, compared
from ffsms_pin.opt.plans import plan_problem
from ffsms_pin.options.tables import DEGREES, radians
from ffsms_pin.references import Rest
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.scenarios.definition import Scenario
from ffsms_pin.scenarios.fits import COORDINATED_WITH
from ffsms_pin.scenarios.problems import rendezvous, replan_options, replanning
from ffsms_pin.scenarios.tables import BASE_LAWS, NONE_IF_ABSENT
from ffsms_pin.simulation import (
    Actuator,
    Capture,
    Conditions,
    Controller,
    Estimator,
    Guards,
    JointFault,
    JointFriction,
    Reference,
    Sensors,
    Tracking,
    Wrench,
    WristSensor,
    perturb,
    random_plants,
    simulate,
)
from ffsms_pin.simulation.held import Held
from ffsms_pin.simulation.setup import checked_events, set_up

StageProgress = Callable[[str, float], None]

_CONTROL_STEP = 1e-3  # [s] default `dt` of `simulate`


def loop_options(scenario: Scenario, sms: SpaceManipulator, q0: FloatArray) -> dict[str, Any]:
    """Return the keyword arguments of `simulate` that a scenario sets, for a plan from q0 (nq,)."""
    start = scenario.plant_start(sms, q0)
    table = scenario.simulation
    with scenario.named("plant"):
        simulated = _plant(scenario, sms)
    momentum = table.get("momentum")  # if None, `simulate` uses the plan's `momentum` and `base_mode`
    if momentum is None and "v0" not in table and scenario.plan.get("mode", "floating") == "floating":
        momentum = scenario.plan.get("momentum")
        if momentum is None and scenario.meet is not None and scenario.meet.get("rest_after"):
            momentum = scenario.problem(sms, q0).momentum
    with scenario.named("attitude"):
        law = base_law(scenario.attitude, sms)
    return {
        "dt": scenario.control.get("dt", _CONTROL_STEP),
        "q0": q0 if start is None else start,
        "plant": simulated,
        "base_controller": law,
        "conditions": scenario.made(
            Conditions,
            "simulation",
            momentum=momentum,
            disturbances=_wrenches(scenario, simulated),
            events=_events(scenario, simulated),
            guards=guards(scenario),
            **{name: _device(scenario, name) for name in _DEVICES},
        ),
    }


# The classes of devices, by the name of their table and of their field in `simulation.Conditions`.
_DEVICES: Mapping[str, type] = {
    "friction": JointFriction,
    "actuator": Actuator,
    "sensors": Sensors,
    "wrist": WristSensor,
    "estimator": Estimator,
}


def _device(scenario: Scenario, name: str) -> Any:
    """Return the device of table `name`; False if it is switched off.

    The result is None without the table, and for an empty table other than [wrist].
    """
    table = scenario.tables[name]
    if table is None or (not table and name not in NONE_IF_ABSENT):
        return None
    return scenario.made(_DEVICES[name], name) if table.get("on", True) else False


def _wrenches(scenario: Scenario, plant: SpaceManipulator) -> tuple[Wrench, ...]:
    """Return the wrenches of [[disturbance]], checked against the plant."""
    wrenches = []
    for i in range(1, len(scenario.disturbance) + 1):
        with scenario.named(path := f"disturbance.{i}"):
            wrenches.append(scenario.made(Wrench, path))
            wrenches[-1].force(plant)
    return tuple(wrenches)


def _events(scenario: Scenario, plant: SpaceManipulator) -> tuple[Capture | JointFault, ...]:
    """Return the events of [[capture]] and [[fault]], checked against plant and duration."""
    duration = scenario.duration if scenario.meet is None else np.inf  # a client's capture has no fixed end
    events: list[Any] = []
    kinds: dict[str, Any] = {"capture": Capture, "fault": JointFault}
    for name, kind in kinds.items():
        for i, row in enumerate(scenario.tables[name], start=1):
            with scenario.named(f"{name}.{i}"):
                events += checked_events(kind(**row), plant, duration)
    return tuple(events)


def guards(scenario: Scenario, path: Path | None = None) -> Guards | None:
    """Return the guards of a scenario; None if [guards] switches them off.

    If a guard stops the run or the state diverges, the recording is saved to `path`. If [guards] does not
    limit the contact load, the limits of [contact.envelope] apply.
    """
    envelope = scenario.contact.get("envelope", {})
    loads = {f"contact_{name}": envelope[name] for name in ("force", "torque") if name in envelope}
    if not scenario.guards.get("on", True):
        return None
    missing = {key: value for key, value in loads.items() if key not in scenario.guards}
    return scenario.made(Guards, "guards", **missing, path=path)


def _plant(scenario: Scenario, sms: SpaceManipulator) -> SpaceManipulator:
    """Return the plant: the model itself, the model with other inertial parameters, or another robot."""
    simulated = scenario.load_plant(sms) if "model" in scenario.plant else sms
    errors, shares = _without(scenario.plant, "model", "end_effector", "random"), scenario.plant.get("random")
    if errors:
        simulated = perturb(simulated, **errors)
    if shares is not None:
        seed = np.random.default_rng(shares["seed"])
        with scenario.named("plant.random"):
            (simulated,) = random_plants(simulated, seed, 1, **_without(shares, "seed"))
    return simulated


def controller(scenario: Scenario, sms: SpaceManipulator) -> JointLaw:
    """Make the scenario's control law, with the gains and torque limits of [control]."""
    law = scenario.law
    gains = _without(scenario.control, "law", "dt", "offset", "offset" + DEGREES, "torque_limit")
    torque_limit = scenario.per_joint(sms, "control", "torque_limit")
    attitude = scenario.attitude or {}
    if law == "computed-torque" and scenario.meet is not None:
        gains.setdefault("adaptive", False)  # adaptation would fit a client's load as friction or payload
    with scenario.named("control", "attitude"):
        if law == COORDINATED_WITH and attitude.get("law") == "coordinated":
            return Coordinated(sms, torque_limit=torque_limit, **gains, **_base_options(attitude))
        return LAWS[law](sms, torque_limit=torque_limit, **gains)


def base_law(attitude: Mapping[str, Any] | None, sms: SpaceManipulator) -> BaseLaw | None:
    """Return the law of the base in [attitude]; None if the file has no such table."""
    if attitude is None:
        return None
    law: BaseLaw = BASE_LAWS[attitude.get("law", "quaternion")](sms, **_base_options(attitude))
    return law


def _base_options(attitude: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keyword arguments of a base law from the table [attitude]."""
    options = radians(_without(attitude, "law", "dump"))
    if "attitude" in options:
        options["attitude"] = pin.rpy.rpyToMatrix(np.array(options["attitude"]))
    if attitude.get("dump") is not None:
        options["dump"] = MomentumDump(**attitude["dump"])
    return options


def _without(values: Mapping[str, Any], *keys: str) -> dict[str, Any]:
    """Return a copy of a table without the named keys."""
    return {key: value for key, value in values.items() if key not in keys}


class Attempt(NamedTuple):
    """A complete or stopped run.

    Attributes
    ----------
    tracking : Tracking
        The recording. If the state diverged, it ends at the last finite state.
    stopped : str
        The time and the reason for a stop; empty for a complete run.
    """

    tracking: Tracking
    stopped: str


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """The closed loop of a scenario; `options` are the keyword arguments of `simulate`."""

    scenario: Scenario
    sms: SpaceManipulator
    options: dict[str, Any]

    @property
    def plant(self) -> SpaceManipulator:
        """The simulated robot."""
        plant: SpaceManipulator = self.options["plant"]
        return plant

    def reference(self, plan: opt.Trajectory) -> Reference:
        """Return the reference: the plan, or a reference that re-plans in the loop."""
        return replanning(self.scenario, self.sms, plan) if self.scenario.replans else self.plan_once(plan)

    def plan_once(self, plan: opt.Trajectory) -> Reference:
        """Return the plan, followed by rest for as long as the scenario holds the target.

        In a rendezvous the reference ends at the contact, without rest. Along a path on a measured client the
        plan gets the true client, by which the simulated motion is judged.
        """
        scenario = self.scenario
        if scenario.meet is not None:
            return rendezvous(scenario, self.sms).reference(plan, None)
        if scenario.path is not None and "sensor" in (scenario.client or {}) and plan.problem is not None:
            plan = replace(plan, problem=with_client(plan.problem, scenario.made_client(self.sms)))
        hold = scenario.duration - scenario.arrival
        return Held(plan, hold) if hold > 0.0 else plan

    def run(
        self, reference: Reference, law: Controller, progress: Callable[[float], None] | None = None
    ) -> Tracking:
        """Follow a reference under a law."""
        return simulate(self.sms, reference, law, progress=progress, **self.options)

    def saving(self, path: Path | None) -> ClosedLoop:
        """Return a copy with guards that save the recording to `path`; without a path, the loop itself."""
        if path is None:
            return self
        conditions = replace(self.options["conditions"], guards=guards(self.scenario, path))
        return replace(self, options={**self.options, "conditions": conditions})


def prepared(scenario: Scenario, sms: SpaceManipulator, q0: FloatArray) -> ClosedLoop:
    """Return a scenario's closed loop for a plan from q0 (nq,), after a check of its options."""
    loop = ClosedLoop(scenario, sms, loop_options(scenario, sms, q0))
    if scenario.replans:
        replanning(scenario, sms)
    target = scenario.target.get("position", (0.0, 0.0, 0.0))
    with scenario.named("control", "simulation", "plan"):
        conditions = replace(loop.options["conditions"], events=())  # `_events` has checked the events
        rest = Rest(scenario.duration, target, sms.joint_positions(q0))
        set_up(sms, rest, **{**loop.options, "conditions": conditions})
    return loop


def attempt(run: Callable[[], Tracking]) -> Attempt:
    """Call `run`; if the state diverges, keep the recording up to the last finite state."""
    try:
        tracking = run()
        return Attempt(tracking, tracking.stopped)
    except SimulationDiverged as error:
        return Attempt(error.tracking, str(error))


def planned(
    scenario: Scenario,
    sms: SpaceManipulator,
    q0: FloatArray,
    progress: Callable[[float], None] | None,
    method: str | None = None,
) -> opt.Trajectory:
    """Plan the scenario's motion from q0 (nq,); `method` replaces the method of [plan]."""
    method = scenario.plan.get("method", "horizon") if method is None else method
    options = opt.SearchOptions(**scenario.options(opt.SearchOptions, "plan"))
    problem = scenario.problem(sms, q0)
    with scenario.named("plan", "target"):
        return plan_problem(problem, method, options, progress)


class Timing(NamedTuple):
    """The wall times of planning and tracking [s]."""

    planning: float
    tracking: float


@dataclass(frozen=True, eq=False)  # `==` of arrays is an array, not a bool
class Outcome:
    """The outcome of a scenario.

    Attributes
    ----------
    sms : SpaceManipulator
        The model that planner and controller use.
    plant : SpaceManipulator
        The simulated robot.
    controller : JointLaw
    trajectory : Trajectory
        The plan.
    tracking : Tracking
        The recording of the closed loop, with the plan or the re-planned motion as reference; for a capture
        of a client, at most up to the deadline of the plan.
    timing : Timing
    note : str
        The notes of re-planning, such as the predicted reason for a miss; empty if there are none.
    open_loop : Attempt, optional
        The run that follows the first plan under the same conditions, if the motion was re-planned.
    capture : Captured, optional
        The result of a capture, if the scenario has one.
    learnt : mapping, optional
        The bodies of [learn]: prior, estimate and truth (`identification.compared`).
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
    """Plan the scenario's motion and follow it in closed loop under the scenario's conditions.

    A missed target is no error. If the plan misses it, `outcome.trajectory.reached` is False; if the
    simulated motion misses it, `outcome.tracking.arrived` is False.

    Parameters
    ----------
    progress : callable, optional
        A function that is called with a stage ("planning", "tracking" or "plan once") and its completed
        share, 0 to 1.
    folder : Path, optional
        The folder of the results, to which the file of [guards] is relative. Default: the folder of the
        scenario's file.
    allow_outside : bool
        True if the file of [guards] may lie outside that folder.

    Raises
    ------
    InvalidScenario
        A value does not fit the robot, or a file lies outside the folder.
    ResultError
        The file of [guards] cannot be written; raised before planning.
    FfsmsError
        The robot cannot be loaded, or the simulation does not stay finite.
    """
    check_call(scenario, progress)
    sms = scenario.load()
    with scenario.named():
        path = _recording_path(scenario, folder, allow_outside)
        q0 = scenario.start_configuration(sms)
        law = controller(scenario, sms)
        loop = prepared(scenario, sms, q0)
        started = time.perf_counter()
        trajectory = planned(scenario, sms, q0, stage(progress, "planning"))
        ended = time.perf_counter()
        report = stage(progress, "tracking")
        tracking, captured, note, learnt = flown(loop.saving(path), trajectory, law, report)
        tracked, open_loop = time.perf_counter(), None
        if scenario.replans:
            report = stage(progress, "plan once")
            open_loop = attempt(partial(loop.run, loop.plan_once(trajectory), law, report))
    timing = Timing(ended - started, tracked - ended)
    return Outcome(
        scenario, sms, loop.plant, law, trajectory, tracking, timing, note, open_loop, captured, learnt
    )


def flown(
    loop: ClosedLoop,
    plan: opt.Trajectory,
    law: JointLaw,
    progress: Callable[[float], None] | None = None,
    once: bool = False,
) -> tuple[Tracking, Captured | None, str, Mapping[str, Any] | None]:
    """Simulate a plan under a law, with re-planning and the capture of a client if the scenario has them.

    If `once` is True, the plan is followed without re-planning. Return the recording, the capture, and the
    note and the estimates of re-planning.
    """
    if loop.scenario.meet is not None:
        flight = _fly(loop, plan, progress, once)
        return flight.captured.approach, flight.captured, flight.note, None
    reference = loop.plan_once(plan) if once else loop.reference(plan)
    if isinstance(reference, opt.Replanning) and reference.learn is not None:
        reference.law = law
    tracking = loop.run(reference, law, progress)
    law.sms = loop.sms
    if not isinstance(reference, opt.Replanning):
        return tracking, None, "", None
    learn = reference.learn
    learnt = compared(learn, loop.plant) if isinstance(learn, Identifier) else None
    return tracking, None, reference.note, learnt


def _fly(
    loop: ClosedLoop, plan: opt.Trajectory, progress: Callable[[float], None] | None, once: bool
) -> capture.Flight:
    """Fly a scenario's capture by `capture.fly`; see `flown` for the parameters."""
    scenario, sms = loop.scenario, loop.sms
    meeting, attitude = rendezvous(scenario, sms), scenario.attitude
    base = None if attitude is None else partial(base_law, attitude)
    plant, masses = scenario.plant, scenario.contact.get("masses", {})
    return capture.fly(
        **{field.name: getattr(meeting, field.name) for field in fields(meeting)},
        envelope=scenario.made(capture.Envelope, "contact.envelope"),
        control=capture.Control(partial(controller, scenario), base, loop.options["dt"]),
        plant=loop.plant,
        plant_q0=loop.options["q0"],
        conditions=loop.options["conditions"],
        replan=replan_options(scenario, sms, capture.Replan) if scenario.replans and not once else False,
        procedure=scenario.made(
            capture.Procedure,
            "contact",
            go=scenario.made(capture.GoLimits, "contact.go"),
            masses=capture.MassUncertainty.of_plant(plant, plant.get("random"), **masses),
        ),
        plan=plan,
        progress=progress,
    )


def check_call(scenario: Scenario, progress: StageProgress | None) -> None:
    """Raise `InvalidValue` if `scenario` is no Scenario, or `progress` neither a function nor None."""
    instance("scenario", scenario, Scenario)
    optional_callable("progress", progress)


def stage(progress: StageProgress | None, name: str) -> Callable[[float], None] | None:
    """Report the beginning of a stage and return a function that reports the completed share, 0 to 1."""
    if progress is None:
        return None
    progress(name, 0.0)
    return partial(progress, name)


def _recording_path(scenario: Scenario, folder: Path | None, allow_outside: bool) -> Path | None:
    """Return the path of the recording that the guards save; None if [guards] has no path.

    The path in [guards] is relative to `folder`, by default the folder of the scenario's file. Raise
    `InvalidScenario` if the path lies outside this folder without `allow_outside`, and `ResultError` if the
    recording cannot be written.
    """
    name = scenario.guards.get("path")
    if name is None:
        return None
    title = "the scenario's folder" if folder is None else "the results folder"
    folder = scenario.source.parent if folder is None else path_like("folder", folder)
    path: Path = folder / name
    if not allow_outside and not Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder)):
        raise InvalidScenario(
            scenario.source,
            f"[guards] path = '{name}' lies outside {title} {folder}: name a file below it, or "
            "allow it with allow_outside=True",
        )
    check_writable(path)
    return path
