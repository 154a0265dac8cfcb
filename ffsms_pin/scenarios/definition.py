"""The class `Scenario`, and functions that read it from TOML and store it with the results of a run."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeVar, get_origin

import numpy as np
import pinocchio as pin
from pydantic import ValidationError

from ffsms_pin import opt
from ffsms_pin.actuation import ReactionWheels, Thrusters
from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidScenario, InvalidValue, ResultError, meant
from ffsms_pin.files import read_json, read_toml, write_content
from ffsms_pin.options.messages import (
    LOADING,
    message_of_check,
    message_of_loading,
    message_of_value,
)
from ffsms_pin.options.tables import DEGREES, radians, table_at
from ffsms_pin.robot import SatelliteBase, SpaceManipulator, load, mount, satellite_names
from ffsms_pin.robot.mounting import face_placement
from ffsms_pin.scenarios.fits import check_fits
from ffsms_pin.scenarios.problems import (
    made_client,
    made_obstacles,
    planning_problem,
)
from ffsms_pin.scenarios.tables import DEFAULT_LAW, NONE_IF_ABSENT, ScenarioFile
from ffsms_pin.system import RobotLimits
from ffsms_pin.urdf import model_names

T = TypeVar("T")

# Wrong names of tables that users may write, and the right names, for messages.
_SYNONYMS = {"goal": "target", "waypoint": "via", "noise": "sensors", "controller": "control"}


@dataclass(frozen=True, eq=False)
class Scenario:
    """The checked tables of a scenario file, and methods that make robot, problem, client and start.

    Each table is an attribute, such as `scenario.plan`; the page "Scenario files" explains the keys. An
    attribute is empty if the file lacks the table, or None if an empty table has another meaning. Values are
    as in the file: SI units, radians, and degrees under keys that end in `_deg`.

    Attributes
    ----------
    name : str
        The packaged name, or the file's name without its ending.
    source : Path
        The path of the file.
    tables : mapping
        The tables by name. A table that a file may repeat, such as [[via]], is a tuple of mappings.
    allow_import : bool
        True if terms and limits may be imported from a user's Python modules.
    """

    name: str
    source: Path
    tables: Mapping[str, Any]
    allow_import: bool = False

    def __getattr__(self, name: str) -> Any:
        tables = vars(self).get("tables", {})  # no tables while `copy.copy` makes the object
        if name not in tables:
            raise AttributeError(f"'Scenario' has no attribute or table '{name}'", name=name, obj=self)
        return tables[name]

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self.tables]

    def __repr__(self) -> str:
        kind, how = type(self).__name__, "re-planning" if self.replans else "plan"
        return f"{kind}('{self.name}': {self.robot['model']}, {how} of {self.arrival:g} s, {self.law})"

    @property
    def law(self) -> str:
        """The name of the control law, a key of `ffsms_pin.control.LAWS`."""
        return str(self.control.get("law", DEFAULT_LAW))

    @property
    def replans(self) -> bool:
        """True if the motion is re-planned in the loop."""
        return bool(self.reference.get("kind") == "re-planning")

    @property
    def arrival(self) -> float:
        """The duration of [plan] [s]; a path with `timing = "fastest"` may end earlier."""
        return float(self.plan.get("duration", opt.Problem.duration))

    @property
    def duration(self) -> float:
        """`arrival` plus the time of holding the target [s]; a capture may last longer."""
        return self.arrival + float(self.reference.get("hold", 0.0))

    @property
    def clearance(self) -> tuple[float, str]:
        """The required clearance of the plan [m], and the collision mode, see `opt.Clearance`."""
        (source,) = [part for part in self.limit if part["use"] == "clearance"][:1] or [self.plan]
        return float(source.get("clearance", opt.Clearance.clearance)), str(
            source.get("collision", opt.Clearance.collision)
        )

    def load(self) -> SpaceManipulator:
        """Load the robot, with the limits, wheels and thrusters that the scenario sets.

        Raises
        ------
        InvalidScenario
            A value does not fit the robot.
        FfsmsError
            `ffsms_pin.load` cannot load the robot.
        """
        with self.named("robot"):
            sms = self._robot()
            _ = sms.end_effector  # raises if no end effector is chosen
        with self.named("limits"):
            names = [field.name for field in fields(RobotLimits)]
            limits = {name: self.per_joint(sms, "limits", name) for name in names}
            chosen = {name: value for name, value in limits.items() if value is not None}
            if chosen:
                sms = sms.with_limits(replace(sms.limits, **chosen))
        wheels = sms.wheels if self.wheels is None else self.made(ReactionWheels, "wheels")
        thrusters = None if self.thrusters is None else self.made(Thrusters, "thrusters")
        with self.named("wheels", "thrusters"):
            if self.wheels is not None or thrusters is not None:
                sms = sms.with_actuators(wheels=wheels, thrusters=thrusters)
        return sms

    @contextmanager
    def named(self, *paths: str) -> Iterator[None]:
        """Add the scenario file and the wrong key to the messages of errors inside the block.

        `paths` are the tables that the block reads, such as "friction", "client.sensor" or "via.2", the
        second [[via]]. The message names the first table that has the key.
        """
        try:
            yield
        except InvalidValue as error:
            message = message_of_value(error, ScenarioFile, self.tables, paths)
            raise InvalidScenario(self.source, message) from None
        except LOADING as error:
            if str(error).startswith(f"scenario {self.source}"):
                raise
            message = message_of_loading(error, self.tables, paths)
            if not message.startswith(("[robot]", "[plant]")):
                raise InvalidScenario(self.source, message) from None
            error.args = (f"scenario {self.source}: {message}",)  # errors of `load` keep their class
            raise

    def made(self, kind: type[T], path: str, /, **values: Any) -> T:
        """Make an object of the dataclass `kind` from a table's keys and `values`, which have priority."""
        with self.named(path):
            return kind(**{**self.options(kind, path), **values})

    def options(self, kind: type, path: str) -> dict[str, Any]:
        """Return a table's values for fields of a dataclass, in radians; for `path` see `named`."""
        known = {field.name for field in fields(kind)}
        _, table = table_at(self.tables, path)
        return {key: value for key, value in radians(table).items() if key in known}

    def _robot(self) -> SpaceManipulator:
        """Load the robot of [robot]: a complete robot, or an arm on the satellite of [robot.mount]."""
        model, options = self.robot["model"], self._load_options()
        if "mount" not in self.robot:
            return load(self.robot_path(model), **options)
        place, base = radians(self.robot["mount"]), self.made(SatelliteBase, "robot.mount")
        placement, arm = face_placement(base), self.source.parent / model
        if "rpy" in place:
            placement.rotation = pin.rpy.rpyToMatrix(np.array(place["rpy"]))
        if "position" in place:
            placement.translation = np.array(place["position"])
        return mount(arm if arm.is_file() else model, base, placement, **options)

    def _load_options(self) -> dict[str, Any]:
        """Return the keyword arguments of `load` from the table [robot]."""
        options = radians({key: value for key, value in self.robot.items() if key not in ("model", "mount")})
        if "package_dirs" in options:
            options["package_dirs"] = [self.source.parent / folder for folder in options["package_dirs"]]
        return options

    def load_plant(self, sms: SpaceManipulator) -> SpaceManipulator:
        """Load the robot of [plant], with the options of [robot] and the actuators and limits of `sms`."""
        chosen = {"end_effector": self.plant.get("end_effector", sms.end_effector)}
        plant = load(self.robot_path(self.plant["model"]), **{**self._load_options(), **chosen})
        plant = plant.with_actuators(wheels=sms.wheels, thrusters=sms.thrusters)
        if plant.joint_names != sms.joint_names:
            return plant  # `simulate` rejects a plant with other joints
        return plant.with_limits(sms.limits)

    def robot_path(self, model: str) -> str | Path:
        """Return the argument of `load`: a packaged name, or a path relative to the scenario's folder."""
        return model if model in (*model_names(), *satellite_names()) else self.source.parent / model

    problem = planning_problem
    obstacles = made_obstacles
    made_client = made_client

    def start_configuration(self, sms: SpaceManipulator) -> FloatArray:
        """Return the start q0 (nq,) of the plan, with the system's centre of mass at the inertial origin."""
        joints = self.per_joint(sms, "start", "joints")
        assert joints is not None  # the schema requires the key
        return self._placed(sms, "start", "joints", joints)

    def plant_start(self, sms: SpaceManipulator, q0: FloatArray) -> FloatArray | None:
        """Return the start configuration (nq,) of the plant; None if it is the plan's `q0`."""
        if "q0" in self.simulation:
            return sms.checked_configuration("[simulation] q0", self.simulation["q0"])
        offset = self.per_joint(sms, "control", "offset")
        if offset is None or not offset.any():
            return None
        return self._placed(sms, "control", "offset", sms.joint_positions(q0) + offset)

    def per_joint(self, sms: SpaceManipulator, table: str, key: str) -> FloatArray | None:
        """Return the values (n,) of a per-joint key, with angles in radians; None if the key is missing.

        A single number applies to all joints. Raise `InvalidScenario` if the number of values is wrong, or if
        the values are in degrees and the robot has prismatic joints.
        """
        used, values = self._spelt(table, key), getattr(self, table)
        if used not in values:
            return None
        array = np.asarray(values[used], dtype=np.float64)
        if array.shape not in ((), (sms.n,)):
            raise InvalidScenario(
                self.source,
                f"[{table}] {used} must have one value for each of the {sms.n} joints "
                f"({', '.join(sms.joint_names)}), got {array.size}",
            )
        sliding = [name for name, turns in zip(sms.joint_names, sms.layout.turns, strict=True) if not turns]
        if used != key and sliding:
            raise InvalidScenario(
                self.source,
                f"[{table}] {used} is in degrees, but the robot has prismatic joints ({', '.join(sliding)}): "
                f"use the key '{key}', in radians and metres",
            )
        return np.full(sms.n, array if used == key else np.deg2rad(array))

    def _spelt(self, table: str, key: str) -> str:
        """Return the key as written in the file: with or without the ending `_deg`."""
        return key if key in getattr(self, table) else key + DEGREES

    def _placed(self, sms: SpaceManipulator, table: str, key: str, joints: FloatArray) -> FloatArray:
        """Return the configuration (nq,) at joint positions (n,); raise `InvalidScenario` beyond limits."""
        outside = sms.limits.violation(joints)
        if outside.any():
            i = int(np.argmax(outside))
            unit, factor = sms.layout.units[i]
            at, low, high = (factor * x[i] for x in (joints, sms.limits.lower, sms.limits.upper))
            raise InvalidScenario(
                self.source,
                f"[{table}] {self._spelt(table, key)} puts joint '{sms.joint_names[i]}' at {at:.6g} {unit}, "
                f"outside its limits [{low:.6g}, {high:.6g}] {unit}",
            )
        return sms.configuration(joints)


def scenario(name_or_path: str | os.PathLike[str], *, allow_import: bool = False) -> Scenario:
    """Read a scenario.

    Keys and values are checked, but the robot is not loaded; see `Scenario.load`. Reading a file runs no code
    of the user. If `allow_import` is True, planning imports the Python modules that the file names in
    [[term]] and [[limit]]. Allow this only for files that you trust like a program.

    Parameters
    ----------
    name_or_path : str or path
        A packaged scenario, one of `scenario_names()`, or a TOML file.
    allow_import : bool
        True to allow a user's own terms and limits, written `use = "package.module:Class"`.

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
    """Return a scenario from the content of a TOML file; paths are relative to the folder of `source`."""
    return Scenario(source.stem, source, checked_tables(source, content), allow_import)


def save_scenario(scenario: Scenario, path: str | os.PathLike[str]) -> None:
    """Write a scenario's name, file path and tables to a JSON file, atomically."""
    tables = {name: table for name, table in scenario.tables.items() if table or table == {}}
    content = {"name": scenario.name, "file": str(scenario.source.absolute()), "tables": tables}
    write_content(path, json.dumps(content, indent=1, ensure_ascii=False) + "\n")


def load_scenario(path: str | os.PathLike[str]) -> Scenario:
    """Read a scenario that `save_scenario` wrote.

    Raises
    ------
    ResultError
        The file is not a file of `save_scenario`.
    InvalidScenario
        Its tables are not valid.
    """
    content, kinds = read_json(path), {"tables": dict, "name": str, "file": str}
    if not all(isinstance(content.get(key), kind) for key, kind in kinds.items()):
        raise ResultError(path, "is not the scenario of a run")
    return replace(scenario_of(Path(content["file"]), content["tables"]), name=content["name"])


def scenario_names() -> list[str]:
    """Return the names of the packaged scenarios."""
    return sorted(file.stem for file in Path(__file__).parent.glob("*.toml"))


def packaged_path(name: str) -> Path:
    """Return the path of a packaged scenario's TOML file."""
    return Path(__file__).with_name(f"{name}.toml")


def read(source: Path) -> dict[str, Any]:
    """Read a TOML file; raise `InvalidScenario` if it is missing, cannot be read, or is not TOML."""
    try:
        return read_toml(source)
    except ResultError as error:
        problem, names = error.problem, scenario_names()
        if isinstance(error.__context__, FileNotFoundError | NotADirectoryError):
            problem = f"there is no such file, nor a packaged scenario of that name ({', '.join(names)})"
            problem += meant(source, names, "; ")
        raise InvalidScenario(source, problem) from None


def schema() -> dict[str, Any]:
    """Return the JSON Schema of a scenario file, with which editors complete keys and show their units."""
    fields = ScenarioFile.model_json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **fields}


def checked_tables(source: Path, content: Mapping[str, Any]) -> dict[str, Any]:
    """Check the tables of a scenario and return them.

    Raise `InvalidScenario` if a key or value is wrong, or if tables do not fit together. A missing table is
    returned empty, or as None if an empty table has another meaning.
    """
    if "watchdog" in content and "guards" not in content:  # former name of [guards]
        content = {"guards" if name == "watchdog" else name: value for name, value in content.items()}
    try:
        typed = ScenarioFile.model_validate(content).given_values()
    except ValidationError as error:
        raise InvalidScenario(source, message_of_check(error, ScenarioFile, content, _SYNONYMS)) from None
    tables: dict[str, Any] = {}
    for name, field in ScenarioFile.model_fields.items():
        absent: Any = () if get_origin(field.annotation) is list else None if name in NONE_IF_ABSENT else {}
        tables[name] = typed.get(name, absent)
    check_fits(source, tables)
    return tables
