"""The JSON Schema of scenario files, and packaged files as text."""

from __future__ import annotations

import inspect
import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from ffsms_pin import control, opt, simulation
from ffsms_pin.cli.main import main
from ffsms_pin.scenarios import parts, scenario, scenario_names, tables
from ffsms_pin.scenarios.file import packaged_path, schema
from ffsms_pin.scenarios.keys import Keys, about
from ffsms_pin.scenarios.parts import PACKAGED
from ffsms_pin.scenarios.tables import ScenarioFile


def test_every_table_and_key_is_in_the_schema_with_its_unit() -> None:
    made = schema()
    assert set(made["properties"]) == set(ScenarioFile.model_fields)
    friction = made["$defs"]["JointFriction"]["properties"]
    assert friction["viscous"]["unit"] == "N m s/rad"
    assert friction["transition_deg"]["unit"] == "deg"
    assert made["$defs"]["JointFriction"]["additionalProperties"] is False
    start = made["$defs"]["StartTable"]
    assert {"anyOf": [{"required": ["joints"]}, {"required": ["joints_deg"]}]} in start["allOf"]
    assert made["$defs"]["PlanTable"]["properties"]["mode"]["enum"][0] == "floating"


def test_an_editor_takes_what_the_library_takes(tmp_path: Path) -> None:
    """Packaged files, terms and limits of ours and of one's own; and it marks what is misspelt."""
    editor = jsonschema.Draft202012Validator(schema())
    for name in scenario_names():
        editor.validate(tomllib.loads(packaged_path(name).read_text("utf-8")))
    rows = [{"use": use} for use in (*PACKAGED["term"], "my_parts:Quiet")]
    content = {"robot": {"model": "planar_3r"}, "start": {"joints_deg": [1.0]}, "term": rows}
    editor.validate(content)
    for wrong in ({"use": "smoth"}, {"use": "smooth", "wieght": 1.0}, {"use": "smooth", "weight": -1.0}):
        assert not editor.is_valid({**content, "term": [wrong]})


def test_the_command_prints_what_editors_and_users_take(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["scenario", "--schema"]) == 0
    assert json.loads(capsys.readouterr().out) == schema()
    for name in scenario_names():
        assert main(["scenario", "--print", name]) == 0
        path = tmp_path / f"{name}.toml"
        path.write_text(capsys.readouterr().out, encoding="utf-8")
        assert scenario(path).plan == scenario(name).plan
    assert main(["scenario", "--print", "case-3"]) == 2
    assert "case-1, case-2" in capsys.readouterr().err


def test_a_closed_pipe_is_no_defect() -> None:
    command = [sys.executable, "-m", "ffsms_pin", "scenario", "--schema"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()  # before anything is written: as `head` does, but not by chance
        assert process.stderr.read() == ""
    assert process.returncode == 141


MADE_OF = [
    (tables.AttitudeTable, control.QuaternionFeedback),
    (tables.TargetTable, opt.Pose),
    (tables.PlanTable, opt.plan),
    (tables.RandomPlantTable, simulation.random_plants),
    *((parts.PARTS[kind][use], made) for kind, rows in PACKAGED.items() for use, made in rows.items()),
    *((tables.ControlTable, law) for law in control.LAWS.values()),
]


@pytest.mark.parametrize(("table", "made"), MADE_OF)
def test_a_default_that_a_table_tells_is_the_library_s(table: type[Keys], made: Any) -> None:
    for name, parameter in inspect.signature(made).parameters.items():
        said = (
            about(table.model_fields[name]).get("default_in_words", "") if name in table.model_fields else ""
        )
        if isinstance(parameter.default, (int, float)) and re.fullmatch(r"(inf|[\d.e-]+)", said):
            assert float(said) == pytest.approx(parameter.default, rel=5e-3), name  # 0.35 rad are 20 deg
