"""The table [learn]: re-planning identifies bodies, and the summary has them beside the true ones."""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from condition_files import QUICK, run_text
from rich.console import Console

import ffsms_pin as ffsms
from ffsms_pin.cli.run import summary_table
from ffsms_pin.errors import InvalidScenario
from ffsms_pin.identification import Identifier
from ffsms_pin.scenarios import scenario, summary
from ffsms_pin.scenarios.problems import learner

LEARN = '[reference]\nkind = "re-planning"\ndt = 0.02\n[learn]\nunknown = ["base"]\n'
LONGER = QUICK.replace("duration = 2.0", "duration = 4.0")


def test_the_summary_has_believed_identified_and_true_bodies(tmp_path: Path) -> None:
    outcome = run_text(tmp_path, LONGER + LEARN + "[plant]\nbase_mass = 1.1\nbase_inertia = 0.9\n")
    numbers: Any = summary(outcome)["learnt"]
    base = {key: numbers["bodies"]["base"][key] for key in ("believed", "learnt", "true")}
    assert 0.0 < numbers["bodies"]["base"]["mass_deviation_kg"] < 1.0
    masses = {key: values["mass_kg"] for key, values in base.items()}
    assert masses["believed"] == pytest.approx(31.015)
    assert masses["true"] == pytest.approx(1.1 * 31.015)
    assert masses["learnt"] == pytest.approx(masses["true"], rel=0.01)
    inertias = {key: values["inertia_kg_m2"][2][2] for key, values in base.items()}
    assert inertias["learnt"] == pytest.approx(inertias["true"], rel=0.01)
    assert inertias["true"] == pytest.approx(0.9 * inertias["believed"], rel=1e-6)
    assert numbers["uncertainty_left"] < 0.1
    assert summary(outcome)["conditions"]["learn"].startswith("unknown")
    text = io.StringIO()
    Console(width=160, file=text).print(summary_table(summary(outcome)))
    assert re.search(r"base: mass .* 34\.12 \+- .* prior 31\.02, true 34\.12 kg", text.getvalue())


def test_known_masses_and_bodies_are_those_of_python(tmp_path: Path) -> None:
    """A known mass is not estimated; a whole body is the prior in place of the model's."""

    def from_file(keys: str) -> Identifier:
        file = tmp_path / "known.toml"
        file.write_text(QUICK + LEARN + keys, encoding="utf-8")
        read = scenario(file)
        identifier = learner(read, read.load())
        assert identifier is not None
        return identifier

    sms = ffsms.load("planar_3r")
    bodies = {"base": 30.0}, {"base": pin.Inertia(30.0, np.array([0.1, 0.0, 0.0]), np.diag([1.0, 1.0, 1.5]))}
    tables = (
        "known = {base = 30.0}\n",
        "[learn.known.base]\nmass = 30.0\ncom = [0.1, 0.0, 0.0]\ninertia = [1.0, 1.0, 1.5]\n",
    )
    for known, keys in zip(bodies, tables, strict=True):
        (expected,), (body,) = Identifier(sms, ["base"], known=known).bodies, from_file(keys).bodies
        for name in ("believed", "deviation", "free"):
            np.testing.assert_array_equal(getattr(expected, name), getattr(body, name))


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ("known = {base = -3.0}", "known must be a finite number above zero, .*got -3"),
        ("known = 3.0", "table of masses or bodies by link"),
        ("known = {bse = 3.0}", "did you mean 'base'"),
        ("known = {link_1 = 2.0}", "not among the unknown bodies"),
        ("[learn.known.base]\nmass = 3.0", "must have the keys mass and inertia"),
        ("[learn.known.base]\nmass = 3.0\ninertia = [1.0, 1.0, 5.0]", "triangle inequality"),
    ],
)
def test_invalid_known_values_are_refused(tmp_path: Path, keys: str, message: str) -> None:
    with pytest.raises(InvalidScenario, match=message):
        run_text(tmp_path, QUICK + LEARN + keys + "\n")


def test_without_the_table_the_summary_has_no_identified_bodies(tmp_path: Path) -> None:
    assert "learnt" not in summary(run_text(tmp_path, QUICK))


def test_inconsistent_tables_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidScenario, match=r"\[learn\] needs \[reference\] kind"):
        run_text(tmp_path, QUICK + '[learn]\nunknown = ["base"]\n')
    with pytest.raises(InvalidScenario, match="link_9"):
        run_text(tmp_path, QUICK + LEARN.replace('["base"]', '["link_9"]'))
    with pytest.raises(InvalidScenario, match="unknown"):
        run_text(tmp_path, QUICK + LEARN.replace('unknown = ["base"]', ""))
