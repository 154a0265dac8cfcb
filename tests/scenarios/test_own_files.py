"""Files that a scenario names: below the results folder, tried before the run, kept when it is stopped."""

from __future__ import annotations

import importlib
import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenario_files import IN_DEGREES

from ffsms_pin.cli import main
from ffsms_pin.errors import InvalidScenario, ResultError
from ffsms_pin.scenarios import run, scenario
from ffsms_pin.scenarios.run import expected_size
from ffsms_pin.simulation import Tracking

QUICK = f"{IN_DEGREES.lstrip()}[plan]\nduration = 3.0\ndt = 0.05\n[control]\ndt = 0.01\n"


def stream(name: str) -> str:
    return f'{QUICK}[simulation]\nstream = "{name}"\n'


def watchdog(name: str) -> str:
    """A run that its watchdog stops at once."""
    return f"{QUICK}[plant]\narm_mass = 3.0\n[watchdog]\njoint_error = 1e-6\npath = '{name}'\n"


@pytest.fixture
def no_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planning is not to begin."""
    module = importlib.import_module("ffsms_pin.scenarios.run")  # the package has a function of that name
    monkeypatch.setattr(module, "planned", lambda *_: pytest.fail("planning has begun"))


@pytest.mark.usefixtures("no_plan")
@pytest.mark.parametrize("make", [stream, watchdog])
@pytest.mark.parametrize("way", ["../x.npz", "{tmp}/x.npz", "link/x.npz", "link.npz"])
def test_a_file_elsewhere_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], make: Any, way: str
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "link").symlink_to(tmp_path)
    (out / "link.npz").symlink_to(tmp_path / "x.npz")
    path = tmp_path / "s.toml"
    path.write_text(make(way.format(tmp=tmp_path)))
    before = sorted(tmp_path.rglob("*"))
    assert main(["run", str(path), "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert "lies outside the results folder" in error
    assert "--allow-outside" in error
    assert error.count("\n") == 1
    with pytest.raises(InvalidScenario, match="outside"):
        run(scenario(path), folder=out)
    assert sorted(tmp_path.rglob("*")) == before


def test_without_a_folder_the_scenarios_own_counts(tmp_path: Path) -> None:
    (tmp_path / "here").mkdir()
    path = tmp_path / "here" / "s.toml"
    path.write_text(stream("../x.npz"))
    with pytest.raises(InvalidScenario, match="outside"):
        run(scenario(path))
    outcome = run(scenario(path), allow_outside=True)
    np.testing.assert_array_equal(Tracking.load(tmp_path / "x.npz").q, outcome.tracking.q)


def test_the_command_line_writes_below_its_folder(tmp_path: Path) -> None:
    path, out = tmp_path / "s.toml", tmp_path / "some" / "out"
    path.write_text(stream("long.npz"))
    assert main(["run", str(path), "--out", str(out), "--no-figures"]) == 0
    assert sorted(os.listdir(tmp_path)) == ["s.toml", "some"]
    written = ["long.npz", "scenario.json", "summary.json", "tracking.npz", "trajectory.npz"]
    assert sorted(os.listdir(out)) == written
    np.testing.assert_array_equal(Tracking.load(out / "long.npz").q, Tracking.load(out / "tracking.npz").q)
    assert json.loads((out / "summary.json").read_text())["scenario"] == "s"
    path.write_text(stream("../far.npz"))
    assert main(["run", str(path), "--out", str(out), "--no-figures", "--allow-outside"]) == 0
    assert len(Tracking.load(tmp_path / "some" / "far.npz").t) == 301


def test_a_stopped_run_leaves_its_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = tmp_path / "s.toml", tmp_path / "out"
    path.write_text(watchdog("stopped.npz"))
    assert main(["run", str(path), "--out", str(out)]) == 2
    assert "recorded until then: " in capsys.readouterr().err.splitlines()[-1]
    assert os.listdir(out) == ["stopped.npz"]
    assert Tracking.load(out / "stopped.npz").t[-1] < 2.0


@pytest.mark.usefixtures("no_plan")
def test_what_cannot_be_written_is_found_out_before_planning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "s.toml", tmp_path / "out"
    for make in (stream, watchdog):
        for name, words in (("none/x.npz", "cannot be written"), (".", "is a folder")):
            path.write_text(make(name))
            assert main(["run", str(path), "--out", str(out)]) == 2
            assert words in capsys.readouterr().err
            assert os.listdir(tmp_path) == ["s.toml"]  # the folder that was made for it has gone
    path.write_text(stream("x.npz"))
    (tmp_path / "x.npz.part").mkdir()
    with pytest.raises(ResultError, match="move it away"):
        run(scenario(path))


@pytest.mark.usefixtures("no_plan")
def test_room_for_the_results_is_asked_for_before_planning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "s.toml"
    path.write_text(QUICK.replace("duration = 3.0", "duration = 36000.0"))
    room = shutil._ntuple_diskusage(10**12, 10**12, 10**8)
    monkeypatch.setattr(shutil, "disk_usage", lambda place: room)
    assert main(["run", str(path), "--out", str(tmp_path / "out")]) == 2
    assert "but only 100 MB are free" in capsys.readouterr().err
    assert os.listdir(tmp_path) == ["s.toml"]


def test_the_expected_size_is_that_of_the_results(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_text(QUICK)
    outcome = run(scenario(path))
    arrays = [
        value.nbytes
        for result in (outcome.trajectory, outcome.tracking)
        for value in vars(result).values()
        if isinstance(value, np.ndarray)
    ]
    size = expected_size(outcome.scenario, outcome.sms)
    assert sum(arrays) <= size + 200  # but for a few numbers that do not grow
    assert size <= 1.05 * sum(arrays)
