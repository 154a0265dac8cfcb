"""A scenario that is kept beside its results is the same scenario."""

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


def test_what_was_said_comes_back(tmp_path: Path) -> None:
    own = scenario(write(tmp_path, QUICK + MORE))
    for one in (own, *(scenario(name) for name in scenario_names())):
        save_scenario(one, tmp_path / "scenario.json")
        again = load_scenario(tmp_path / "scenario.json")
        for field in fields(Scenario):
            if field.name != "source":
                assert getattr(again, field.name) == getattr(one, field.name), field.name
        assert again.source == one.source.absolute()


def test_what_is_no_scenario_is_told(tmp_path: Path) -> None:
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
