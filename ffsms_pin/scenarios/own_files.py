"""The files that a scenario writes by itself, and the space that its results need."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from ffsms_pin.errors import InvalidScenario
from ffsms_pin.scenarios.conditions import control_steps
from ffsms_pin.scenarios.definition import Scenario
from ffsms_pin.scenarios.keys import radians
from ffsms_pin.simulation import Watchdog
from ffsms_pin.simulation.unfinished import check_stream
from ffsms_pin.storage import check_writable
from ffsms_pin.system import SpaceManipulator

__all__ = ["expected_size", "own_files", "writes_files"]

_DOUBLE = 8  # [bytes]
_PLAN_STEP = 0.01  # [s] `plan`'s default


def writes_files(scenario: Scenario) -> bool:
    """Whether a scenario names files to write."""
    return "stream" in scenario.simulation or "path" in (scenario.watchdog or {})


def own_files(scenario: Scenario, folder: Path | None = None, allow_outside: bool = False) -> dict[str, Any]:
    """Options of `simulate` that write files: for one run of a scenario, and not for every one of many.

    Parameters
    ----------
    scenario : Scenario
    folder : Path, optional
        Of the results, where the files' names count from. Default: that of the scenario's file.
    allow_outside : bool
        Whether a file may lie elsewhere than below that folder.

    Raises
    ------
    InvalidScenario
        A file lies elsewhere, and may not.
    ResultError
        A file cannot be written: found out before the run.
    """
    folder = scenario.source.parent if folder is None else folder
    options: dict[str, Any] = {}

    def place(key: str, name: str) -> Path:
        path = folder / name
        if not allow_outside and not Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder)):
            raise InvalidScenario(
                scenario.source,
                f"{key} = '{name}' lies outside the results folder {folder}: name a file below it, or allow "
                "it with --allow-outside (in Python: run(..., allow_outside=True))",
            )
        return path

    if "stream" in scenario.simulation:
        options["stream"] = place("[simulation] stream", scenario.simulation["stream"])
        check_stream(options["stream"])
    if scenario.watchdog is not None and "path" in scenario.watchdog:
        limits = radians(scenario.watchdog)
        path = place("[watchdog] path", limits["path"])
        check_writable(path)
        options["watchdog"] = Watchdog(**{**limits, "path": path})
    return options


def expected_size(scenario: Scenario, sms: SpaceManipulator) -> float:
    """Upper bound of what plan and recording of a run take on disk [bytes]."""
    n, nq = sms.n, sms.nq
    w, k = (0 if one is None else len(one) for one in (sms.wheels, sms.thrusters))
    row = nq + (6 + n) + 3 * n + 11 + 2 * w + k  # of a recording: see `Tracking`
    node = nq + (6 + n) + 4 * n + 9  # of a plan: see `Trajectory`
    steps = scenario.arrival / float(scenario.plan.get("dt", _PLAN_STEP))
    return _DOUBLE * (row * (control_steps(scenario) + 1.0) + node * (steps + 1.0))
