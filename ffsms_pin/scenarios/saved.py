"""A scenario kept beside its results: what the file said, and where its names count from."""

from __future__ import annotations

import json
import os
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from ffsms_pin.errors import ResultError
from ffsms_pin.scenarios.contents import Contents
from ffsms_pin.scenarios.definition import Scenario, scenario_of
from ffsms_pin.storage import read_content, write_content

__all__ = ["load_scenario", "save_scenario"]

_NO_TABLES = ("name", "source", "allow_import")


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
    """Read what `save_scenario` wrote.

    Raises
    ------
    ResultError
        The file cannot be read, or is none of these.
    InvalidScenario
        A table holds something that cannot be used.
    """
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
