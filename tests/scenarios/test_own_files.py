"""The file that guards save: inside the results folder, checked before the run, kept after a stop."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from scenario_files import IN_DEGREES

from ffsms_pin.cli import main
from ffsms_pin.errors import InvalidScenario
from ffsms_pin.scenarios import closed_loop, run, scenario
from ffsms_pin.simulation import Tracking

QUICK = f"{IN_DEGREES.lstrip()}[plan]\nduration = 3.0\ndt = 0.05\n[control]\ndt = 0.01\n"


def guarded(name: str) -> str:
    """Return a scenario whose guards stop the run at once."""
    return f"{QUICK}[plant]\narm_mass = 3.0\n[guards]\njoint_error = 1e-6\npath = '{name}'\n"


@pytest.fixture
def no_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    """A failure of the test if planning begins."""
    monkeypatch.setattr(closed_loop, "planned", lambda *_: pytest.fail("planning has begun"))


@pytest.mark.usefixtures("no_plan")
@pytest.mark.parametrize("name", ["../x.npz", "{tmp}/x.npz", "link/x.npz", "link.npz"])
def test_a_file_elsewhere_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "link").symlink_to(tmp_path)
    (out / "link.npz").symlink_to(tmp_path / "x.npz")
    path = tmp_path / "s.toml"
    path.write_text(guarded(name.format(tmp=tmp_path)))
    before = sorted(tmp_path.rglob("*"))
    assert main(["run", str(path), "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert "lies outside the results folder" in error
    assert "--allow-outside" in error
    assert error.count("\n") == 1
    with pytest.raises(InvalidScenario, match="outside"):
        run(scenario(path), folder=out)
    assert sorted(tmp_path.rglob("*")) == before


def test_without_a_results_folder_that_of_the_scenario_counts(tmp_path: Path) -> None:
    (tmp_path / "here").mkdir()
    path = tmp_path / "here" / "s.toml"
    path.write_text(guarded("../x.npz"))
    with pytest.raises(InvalidScenario, match="outside"):
        run(scenario(path))
    tracking = run(scenario(path), allow_outside=True).tracking
    np.testing.assert_array_equal(Tracking.load(tmp_path / "x.npz").q, tracking.q)


def test_a_file_elsewhere_can_be_allowed(tmp_path: Path) -> None:
    path, out = tmp_path / "s.toml", tmp_path / "some" / "out"
    path.write_text(guarded("../far.npz"))
    assert main(["run", str(path), "--out", str(out), "--no-figures", "--allow-outside"]) == 1
    assert sorted(os.listdir(tmp_path / "some")) == ["far.npz", "out"]
    assert "off its reference" in Tracking.load(tmp_path / "some" / "far.npz").stopped


def test_a_stopped_flight_is_saved_with_its_results(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "s.toml", tmp_path / "out"
    path.write_text(guarded("stopped.npz"))
    assert main(["run", str(path), "--out", str(out), "--no-figures"]) == 1
    shown = " ".join(capsys.readouterr().out.split())
    assert "stopped by a guard" in shown
    assert "off its" in shown
    assert {"stopped.npz", "tracking.npz", "summary.json"} <= set(os.listdir(out))
    stopped = Tracking.load(out / "stopped.npz").stopped
    assert json.loads((out / "summary.json").read_text())["tracking"]["stopped"] == stopped != ""


@pytest.mark.usefixtures("no_plan")
def test_a_file_that_cannot_be_written_is_refused_before_planning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "s.toml", tmp_path / "out"
    for name, fragment in (("none/x.npz", "cannot be written"), (".", "is a folder")):
        path.write_text(guarded(name))
        assert main(["run", str(path), "--out", str(out)]) == 2
        assert fragment in capsys.readouterr().err
        assert os.listdir(tmp_path) == ["s.toml"]  # the folder made for the results is removed
