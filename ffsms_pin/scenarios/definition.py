"""`scenario`: from a name or a TOML file to a `Scenario`, which can be kept beside the results of a run."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from ffsms_pin.checks import FloatArray
from ffsms_pin.client import Client, ClientEstimate
from ffsms_pin.errors import InvalidValue, ResultError
from ffsms_pin.opt import Obstacle, Problem
from ffsms_pin.scenarios.contents import Contents
from ffsms_pin.scenarios.file import checked_tables
from ffsms_pin.scenarios.joints import within_limits
from ffsms_pin.scenarios.problems import planning_problem
from ffsms_pin.scenarios.reading import packaged_path, read, scenario_names
from ffsms_pin.scenarios.task import made_client, made_obstacles
from ffsms_pin.storage import read_content, write_content
from ffsms_pin.system import SpaceManipulator

__all__ = ["Scenario", "load_scenario", "save_scenario", "scenario", "scenario_names", "scenario_of"]

_NO_TABLES = ("name", "source", "allow_import")


class Scenario(Contents):
    """What a scenario file holds, and what is made of it: the robot, the problem, the client, the plant.

    Its attributes are the tables of the file, checked; see `Contents`.
    """

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
            A value does not fit the robot, or a term or limit cannot be made.
        """
        if self.client is not None and client is None:
            client = self.made_client(sms)
        q0 = self.start_configuration(sms) if q0 is None else q0
        return planning_problem(self, sms, q0, dt, client)

    def obstacles(self, client: Any = None) -> list[Obstacle]:
        """What the robot keeps clear of beside itself.

        What is on the client is there only where one is given: anything with `pose(t)` and `poses(times)`.
        """
        return made_obstacles(self.source, self.obstacle, client)

    def made_client(self, sms: SpaceManipulator) -> Client:
        """The client, which may be placed so that it can be met by construction."""
        with self.named("client"):
            return made_client(self, sms)

    def plant_start(self, sms: SpaceManipulator, q0: FloatArray) -> FloatArray | None:
        """Start (nq,) of the simulated arm where it is not the plan's `q0`; None where it is."""
        if "q0" in self.simulation:
            return sms.checked_configuration("[simulation] q0", self.simulation["q0"])
        offset = self.per_joint(sms, "control", "offset")
        if offset is None or not offset.any():
            return None
        joints = sms.joint_positions(q0) + offset
        return sms.configuration(within_limits(self.source, sms, "control", "offset", joints))


def scenario(name_or_path: str | os.PathLike[str], *, allow_import: bool = False) -> Scenario:
    """Read a scenario.

    Its keys and values are checked; the robot is loaded by `Scenario.load`. Reading runs no code of the
    file's. With `allow_import`, planning imports the Python modules that the file names as terms and limits:
    only for files that you trust as you trust a program.

    Parameters
    ----------
    name_or_path : str or path
        A packaged scenario ("case-1", "case-2": the paper's; "wrong-model", "capture": ours), or a TOML file.
    allow_import : bool
        Whether its terms and limits may be a user's own, as `use = "package.module:Class"`.

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
    """A scenario from what a TOML file holds; names of files in it count from the folder of `source`."""
    return Scenario(source.stem, source, **checked_tables(source, content), allow_import=allow_import)


def save_scenario(scenario: Contents, path: str | os.PathLike[str]) -> None:
    """Write the tables of a scenario as JSON, and the path of its file, atomically."""
    tables: dict[str, Any] = {}
    for field in fields(Contents):
        found = getattr(scenario, field.name)
        if field.name not in _NO_TABLES and (found or found == {}):
            tables[field.name] = _without_none(found)
    said = {"name": scenario.name, "file": str(scenario.source.absolute()), "tables": tables}
    write_content(path, json.dumps(said, indent=1, ensure_ascii=False) + "\n")


def load_scenario(path: str | os.PathLike[str]) -> Scenario:
    """Read what `save_scenario` wrote; `ResultError`: the file cannot be read, or is none of these."""
    try:
        said = json.loads(read_content(path))
    except (OSError, ValueError, RecursionError) as error:
        raise ResultError(path, f"cannot be read ({error})") from None
    if not (
        isinstance(said, dict)
        and isinstance(said.get("tables"), dict)
        and all(isinstance(said.get(key), str) for key in ("name", "file"))
    ):
        raise ResultError(path, "is not the scenario of a run")
    return replace(scenario_of(Path(said["file"]), said["tables"]), name=said["name"])


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_none(item) for key, item in value.items() if item is not None}
    return [_without_none(item) for item in value] if isinstance(value, tuple) else value
