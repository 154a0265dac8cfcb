"""`scenario`: from a name or a TOML file to a `Scenario`."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ffsms_pin.checks import FloatArray
from ffsms_pin.client import Client, ClientEstimate
from ffsms_pin.errors import InvalidScenario, InvalidValue
from ffsms_pin.models import load, satellite_names
from ffsms_pin.opt import (
    BaseLimits,
    BaseTurn,
    Clearance,
    Coupling,
    Effort,
    JointLimits,
    Limit,
    Meet,
    Obstacle,
    Problem,
    Smooth,
    Term,
)
from ffsms_pin.opt.goals import as_goal
from ffsms_pin.scenarios.actuated import with_actuators
from ffsms_pin.scenarios.clients import made_client, meeting
from ffsms_pin.scenarios.joint_values import joint_values, within_limits
from ffsms_pin.scenarios.obstacles import made_obstacles
from ffsms_pin.scenarios.parts import made_part, with_parts
from ffsms_pin.scenarios.reading import packaged_path, read, scenario_names
from ffsms_pin.scenarios.schema import checked_tables
from ffsms_pin.scenarios.tables import DEFAULT_LAW, radians
from ffsms_pin.scenarios.targets import goal_of
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.urdf import model_names

__all__ = ["Scenario", "scenario", "scenario_names", "scenario_of"]


@dataclass(frozen=True)
class Scenario:
    """A robot, a start, a target, and how to plan and track: the tables of a scenario file, checked.

    docs/scenarios.md says what each key means. Tables that a file leaves out are empty here, and what they
    would set takes the library's defaults.

    Attributes
    ----------
    name : str
        The packaged name, or the file's name without its ending.
    source : Path
        The file.
    robot, start, target, plan, limits, control : mapping of str to values
        As in the file: SI units, radians, and degrees under keys that end in `_deg`.
    laws : mapping of str to mapping
        Gains of other control laws, for `compare_laws`.
    reference, simulation, plant, friction, actuator, sensors, estimator : mapping of str to values
        The closed loop under real conditions.
    disturbance, capture, fault : tuple of mappings
        What happens on the way.
    watchdog, wheels, thrusters, attitude : mapping of str to values, or None
        None: there is none, and for `attitude` that the base is left to itself.
    client, meet : mapping of str to values, or None
        Who is to be met in place of a target, and how; None: there is a target.
    contact : mapping of str to values
        How the client is caught, and what follows.
    term, limit : tuple of mappings
        Terms and limits of the plan beside, or in place of, those that `plan` describes.
    obstacle : tuple of mappings
        What the robot keeps clear of beside itself.
    campaign : mapping of str to values
        What a campaign draws; a single run does not use it.
    allow_import : bool
        Whether terms and limits may be a user's own, imported from Python modules.
    """

    name: str
    source: Path
    robot: Mapping[str, Any]
    start: Mapping[str, Any]
    target: Mapping[str, Any]
    plan: Mapping[str, Any]
    limits: Mapping[str, Any]
    control: Mapping[str, Any]
    laws: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    reference: Mapping[str, Any] = field(default_factory=dict)
    simulation: Mapping[str, Any] = field(default_factory=dict)
    plant: Mapping[str, Any] = field(default_factory=dict)
    friction: Mapping[str, Any] = field(default_factory=dict)
    actuator: Mapping[str, Any] = field(default_factory=dict)
    sensors: Mapping[str, Any] = field(default_factory=dict)
    estimator: Mapping[str, Any] = field(default_factory=dict)
    disturbance: tuple[Mapping[str, Any], ...] = ()
    capture: tuple[Mapping[str, Any], ...] = ()
    fault: tuple[Mapping[str, Any], ...] = ()
    watchdog: Mapping[str, Any] | None = None
    wheels: Mapping[str, Any] | None = None
    thrusters: Mapping[str, Any] | None = None
    attitude: Mapping[str, Any] | None = None
    client: Mapping[str, Any] | None = None
    meet: Mapping[str, Any] | None = None
    contact: Mapping[str, Any] = field(default_factory=dict)
    term: tuple[Mapping[str, Any], ...] = ()
    limit: tuple[Mapping[str, Any], ...] = ()
    obstacle: tuple[Mapping[str, Any], ...] = ()
    campaign: Mapping[str, Any] = field(default_factory=dict)
    allow_import: bool = False

    def __repr__(self) -> str:
        how = "re-planning" if self.replans else "plan"
        return f"Scenario('{self.name}': {self.robot['model']}, {how} of {self.arrival:g} s, {self.law})"

    @property
    def law(self) -> str:
        """Name of the control law, of `ffsms_pin.control.LAWS`."""
        return str(self.control.get("law", DEFAULT_LAW))

    @property
    def replans(self) -> bool:
        """Whether the motion is planned again in the loop."""
        return bool(self.reference.get("kind") == "re-planning")

    @property
    def arrival(self) -> float:
        """Time to arrive [s]."""
        return float(self.plan.get("duration", 12.0))

    @property
    def duration(self) -> float:
        """Time to simulate [s]: to arrive, and to hold the target."""
        return self.arrival + float(self.reference.get("hold", 0.0))

    @property
    def clearance(self) -> tuple[float, str]:
        """The clearance that the plan keeps [m], and between what."""
        (said,) = [part for part in self.limit if part["use"] == "clearance"][:1] or [self.plan]
        return float(said.get("clearance", 0.01)), str(said.get("collision", "auto"))

    def load(self) -> SpaceManipulator:
        """The robot, with the limits, wheels and thrusters that the scenario sets.

        Raises
        ------
        FfsmsError
            What `ffsms_pin.load` raises; `InvalidScenario` where limits do not fit the robot.
        """
        with_values = {key: value for key, value in self.robot.items() if key != "model"}
        try:
            sms = load(self.robot_path(self.robot["model"]), **with_values)
            limits = {
                name: self.per_joint(sms, "limits", name)
                for name in ("lower", "upper", "velocity", "acceleration", "torque")
            }
            chosen = {name: value for name, value in limits.items() if value is not None}
            if chosen:
                sms = sms.with_limits(replace(sms.limits, **chosen))
            sms = with_actuators(sms, self.wheels, self.thrusters)
        except InvalidValue as error:
            raise InvalidScenario(self.source, str(error)) from None
        return sms

    def robot_path(self, model: str) -> str | Path:
        """What `load` takes for a robot of the file: a known name, or a path from the file's folder."""
        return model if model in (*model_names(), *satellite_names()) else self.source.parent / model

    def start_configuration(self, sms: SpaceManipulator) -> FloatArray:
        """Start q0 (nq,) of the plan: the system's centre of mass at the inertial origin, at rest."""
        joints = self.per_joint(sms, "start", "joints")
        assert joints is not None  # the schema asks for it
        return sms.configuration(within_limits(self.source, sms, "start", "joints", joints))

    def problem(
        self,
        sms: SpaceManipulator,
        q0: FloatArray | None = None,
        dt: float | None = None,
        client: Client | ClientEstimate | None = None,
    ) -> Problem:
        """The planning problem: start, target, time, and every term and limit, made anew.

        Parameters
        ----------
        sms : SpaceManipulator
            As `load` gives it.
        q0 : ndarray, shape (nq,), optional
            Start; default: `start_configuration`.
        dt : float, optional
            Step [s]; default: that of [plan].
        client : Client or ClientEstimate, optional
            Who is to be met, where the scenario meets one; default: where it truly is.

        Raises
        ------
        InvalidScenario
            A value does not fit the robot, or a term or limit cannot be made; one of the user's own is
            imported only with `allow_import`.
        """
        plan = self.plan
        if self.client is not None and client is None:
            client = self.made_client(sms)
        goal = goal_of(self.target) if client is None else self._meeting(client)
        terms: list[Term] = [Smooth()]
        if as_goal(goal).coupled or "kappa" in plan:
            terms.insert(0, Coupling(plan.get("kappa", 10.0)))
        terms.append(Effort(plan["effort"]) if "effort" in plan else Effort())
        if plan.get("base", 0.0) > 0.0:
            terms.append(BaseTurn(plan["base"]))
        try:
            clear = Clearance(*self.clearance, obstacles=self.obstacles(client))
        except InvalidValue as error:
            raise InvalidScenario(self.source, str(error)) from None
        limits: list[Limit] = [JointLimits(), clear]
        if "base_limits" in plan:
            limits.append(BaseLimits(**radians(plan["base_limits"])))
        rows = enumerate(self.term, start=1), enumerate(self.limit, start=1)
        own_terms = [made_part(self.source, "term", i, row, self.allow_import) for i, row in rows[0]]
        own_limits = [
            clear if row["use"] == "clearance" else made_part(self.source, "limit", i, row, self.allow_import)
            for i, row in rows[1]
        ]
        try:
            return Problem(
                sms,
                self.start_configuration(sms) if q0 is None else q0,
                goal,
                self.arrival,
                plan.get("dt", 0.01) if dt is None else dt,
                with_parts(terms, own_terms),
                with_parts(limits, own_limits),
                self.per_joint(sms, "start", "joint_rates"),
                plan.get("momentum"),
                plan.get("locked", ()),
                plan.get("mode", "floating"),
                self.simulation.get("wheel_momentum") if plan.get("mode") == "rotation-floating" else None,
            )
        except InvalidValue as error:
            raise InvalidScenario(self.source, str(error)) from None

    def obstacles(self, client: Client | ClientEstimate | None = None) -> list[Obstacle]:
        """What the robot keeps clear of beside itself; what is on the client, only for one that is given."""
        return made_obstacles(self.source, self.obstacle, client)

    def made_client(self, sms: SpaceManipulator) -> Client:
        """The client; see `clients.made_client`."""
        try:
            return made_client(self, sms)
        except InvalidValue as error:
            raise InvalidScenario(self.source, f"[client] {error}") from None

    def _meeting(self, client: Client | ClientEstimate) -> Meet:
        try:
            return meeting(self, client)
        except InvalidValue as error:
            raise InvalidScenario(self.source, f"[meet] {error}") from None

    def plant_start(self, sms: SpaceManipulator, q0: FloatArray) -> FloatArray | None:
        """Start (nq,) of the simulated arm where it is not the plan's `q0`; None where it is."""
        if "q0" in self.simulation:
            return sms.checked_configuration("[simulation] q0", self.simulation["q0"])
        offset = self.per_joint(sms, "control", "offset")
        if offset is None or not offset.any():
            return None
        joints = sms.joint_positions(q0) + offset
        return sms.configuration(within_limits(self.source, sms, "control", "offset", joints))

    def per_joint(self, sms: SpaceManipulator, table: str, key: str) -> FloatArray | None:
        """Values (n,) of a key that has one a joint, in radians and metres; None where it is not given."""
        return joint_values(self.source, sms, table, getattr(self, table), key)


def scenario(name_or_path: str | os.PathLike[str], *, allow_import: bool = False) -> Scenario:
    """Read a scenario.

    Reading runs no code of the file's. With `allow_import`, planning imports the Python modules that the file
    names as terms and limits: only for files that you trust as you trust a program.

    Parameters
    ----------
    name_or_path : str or path
        A packaged scenario ("case-1", "case-2": the paper's; "wrong-model", "capture": ours), or a TOML file.
    allow_import : bool
        Whether its terms and limits may be a user's own, as `use = "package.module:Class"`.

    Returns
    -------
    Scenario
        Its keys and values checked; the robot is loaded by `Scenario.load`.

    Raises
    ------
    InvalidScenario
        The file is missing or not TOML, or holds a key or a value that cannot be used.
    """
    if str(name_or_path) in scenario_names():
        source = packaged_path(str(name_or_path))
    else:
        try:
            source = Path(name_or_path)
        except TypeError:
            raise InvalidValue("scenario", name_or_path, "must be a name or a path") from None
    return scenario_of(source, read(source), allow_import=allow_import)


def scenario_of(source: Path, content: Mapping[str, Any], *, allow_import: bool = False) -> Scenario:
    """A scenario from what a TOML file holds; names of files in it count from the folder of `source`.

    Raises
    ------
    InvalidScenario
        As for `scenario`.
    """
    return Scenario(source.stem, source, **checked_tables(source, content), allow_import=allow_import)
