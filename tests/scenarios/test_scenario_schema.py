"""The JSON Schema of scenario files, and packaged files as text."""

from __future__ import annotations

import inspect
import json
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import get_args

import jsonschema
import pytest

from ffsms_pin import control, opt, simulation
from ffsms_pin.cli.main import main
from ffsms_pin.options.tables import about, models_in, options_of
from ffsms_pin.scenarios import scenario, scenario_names
from ffsms_pin.scenarios.definition import packaged_path, schema
from ffsms_pin.scenarios.tables import PACKAGED, ScenarioFile


def test_every_table_and_key_is_in_the_schema_with_its_unit() -> None:
    generated = schema()
    assert set(generated["properties"]) == set(ScenarioFile.model_fields)
    friction = generated["$defs"]["JointFriction"]["properties"]
    assert friction["viscous"]["unit"] == "N m s/rad"
    assert friction["transition_deg"]["unit"] == "deg"
    assert generated["$defs"]["JointFriction"]["additionalProperties"] is False
    start = generated["$defs"]["StartTable"]
    assert {"anyOf": [{"required": ["joints"]}, {"required": ["joints_deg"]}]} in start["allOf"]
    assert generated["$defs"]["PlanTable"]["properties"]["mode"]["enum"][0] == "floating"


def test_the_schema_accepts_what_the_library_accepts(tmp_path: Path) -> None:
    """The schema accepts packaged files, packaged and custom terms, and rejects misspelt ones."""
    editor = jsonschema.Draft202012Validator(schema())
    for name in scenario_names():
        editor.validate(tomllib.loads(packaged_path(name).read_text("utf-8")))
    rows = [{"use": use} for use in (*PACKAGED["term"], "my_parts:Quiet")]
    content = {"robot": {"model": "planar_3r"}, "start": {"joints_deg": [1.0]}, "term": rows}
    editor.validate(content)
    for wrong in ({"use": "smoth"}, {"use": "smooth", "wieght": 1.0}, {"use": "smooth", "weight": -1.0}):
        assert not editor.is_valid({**content, "term": [wrong]})


def test_the_command_prints_the_schema_and_packaged_files(
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


def test_a_closed_pipe_gives_no_error_message() -> None:
    command = [sys.executable, "-m", "ffsms_pin", "scenario", "--schema"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()  # before anything is written, so that the test does not depend on timing
        assert process.stderr.read() == ""
    assert process.returncode == 141


@pytest.mark.parametrize(
    ("table", "name", "default"),
    [
        ("plan", "effort", opt.Effort.weight),
        ("plan", "reach", opt.Pose.reach),
        ("control", "dt", inspect.signature(simulation.simulate).parameters["dt"].default),
    ],
)
def test_documented_defaults_are_those_of_the_library(table: str, name: str, default: float) -> None:
    model = models_in(ScenarioFile.model_fields[table].annotation)[0]
    assert float(about(model.model_fields[name])["default_in_words"]) == default


def test_options_of_a_law_come_from_its_parameters() -> None:
    """Each law has a table with its own gains, with their units, defaults and descriptions."""
    for model in models_in(ScenarioFile.model_fields["control"].annotation):
        (law,) = get_args(model.model_fields["law"].annotation)
        common = {"law", "torque_limit", "dt", "offset"}
        assert set(model.model_fields) == common | set(options_of(control.LAWS[law]))
        assert set(model.chosen_keys()) == set(model.model_fields) - common
    pd, sliding = model.choices["pd"], model.choices["sliding-mode"]
    stiffness = about(pd.model_fields["K_p"])
    assert (stiffness["unit"], stiffness["default_in_words"]) == ("N m/rad", "0.5")
    assert str(sliding.model_fields["Gamma"].description).startswith("Slope of the sliding surface")


def test_the_schema_offers_the_keys_of_the_choice(tmp_path: Path) -> None:
    """A table with a choice takes the keys of this choice only."""
    editor = jsonschema.Draft202012Validator(schema())
    content = {"robot": {"model": "planar_3r"}, "start": {"joints": [1.0]}}
    for table, right, wrong in (
        ("control", {"K_s": 1.0}, {"law": "pd", "K_s": 1.0}),
        ("control", {"law": "pd", "K_p": 1.0}, {"K_p": 1.0}),
        ("path", {"curve": "line", "end": [1.0, 0.0, 0.0]}, {"curve": "line", "radius": 1.0}),
        ("contact", {"kind": "compliant", "time": 0.1, "ring": {}}, {"time": 0.1}),
    ):
        editor.validate({**content, table: right})
        assert not editor.is_valid({**content, table: wrong})


def test_every_key_has_a_description() -> None:
    for table, field in ScenarioFile.model_fields.items():
        for model in models_in(field.annotation):
            for name, inner in model.model_fields.items():
                if not models_in(inner.annotation) and table not in ("term", "limit"):
                    assert inner.description, f"{table}.{name}"
