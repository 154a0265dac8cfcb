"""The JSON Schema of scenario files, and packaged files as text."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from ffsms_pin.cli.main import main
from ffsms_pin.scenarios import scenario, scenario_names
from ffsms_pin.scenarios.file import ScenarioFile, schema


def test_every_table_and_key_is_in_the_schema_with_its_unit() -> None:
    made = schema()
    assert set(made["properties"]) == set(ScenarioFile.model_fields)
    friction = made["$defs"]["Friction"]["properties"]
    assert friction["viscous"]["unit"] == "N m s/rad"
    assert friction["transition_deg"]["unit"] == "deg"
    assert made["$defs"]["Friction"]["additionalProperties"] is False
    start = made["$defs"]["Start"]
    assert {"anyOf": [{"required": ["joints"]}, {"required": ["joints_deg"]}]} in start["allOf"]
    assert made["$defs"]["Plan"]["properties"]["mode"]["enum"][0] == "floating"


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
