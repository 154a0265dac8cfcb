"""Scenarios saved beside their results load unchanged."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path

import pytest
from scenario_files import QUICK, write

from ffsms_pin.errors import InvalidScenario, ResultError
from ffsms_pin.scenarios import Scenario, scenario, scenario_names
from ffsms_pin.scenarios.definition import load_scenario, save_scenario

MORE = """
[plan.base_limits]
attitude_deg = 3.0
translation = inf
[[obstacle]]
shape = "box"
size = [0.1, 0.1, 0.1]
position = [2.0, 0.0, 0.0]
[[via]]
position = [0.8, 0.5, 0.0]
[guards]
"""


def test_saved_scenarios_load_unchanged(tmp_path: Path) -> None:
    own = scenario(write(tmp_path, QUICK + MORE))
    for original in (own, *(scenario(name) for name in scenario_names())):
        save_scenario(original, tmp_path / "scenario.json")
        again = load_scenario(tmp_path / "scenario.json")
        for field in fields(Scenario):
            if field.name != "source":
                assert getattr(again, field.name) == getattr(original, field.name), field.name
        assert again.source == original.source.absolute()


def test_invalid_saved_scenarios_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "scenario.json"
    for text in ("", "[1]", '{"name": "a", "file": "b", "tables": []}'):
        path.write_text(text)
        with pytest.raises(ResultError):
            load_scenario(path)
    path.write_text(json.dumps({"name": "a", "file": "b.toml", "tables": {"robot": {"modell": "planar_3r"}}}))
    with pytest.raises(InvalidScenario, match="modell"):
        load_scenario(path)
    with pytest.raises(ResultError):
        load_scenario(tmp_path / "absent.json")
