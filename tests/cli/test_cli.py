"""Test results, tables and exit codes of `ffsms-pin run`."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scenario_files import COARSE

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.cli import main
from ffsms_pin.plotting import FIGURES
from ffsms_pin.simulation import Tracking

NUMBERS = {"trajectory.npz", "tracking.npz", "scenario.json", "summary.json"}
ALL = NUMBERS | {f"{name}.{ending}" for name in FIGURES for ending in ("pdf", "png")}


def _ended(error: str) -> list[str]:
    """Return the names of the finished stages, without the progress lines of a slow machine."""
    return [line.split(":")[0] for line in error.splitlines() if "% after" not in line]


def test_run_writes_everything(quick: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "some" / "where"
    assert main(["run", str(quick), "--out", str(out)]) == 0
    assert {path.name for path in out.iterdir()} == ALL
    assert {path.name for path in tmp_path.iterdir()} == {"quick.toml", "some"}

    plan = opt.Trajectory.load(out / "trajectory.npz")
    tracking = Tracking.load(out / "tracking.npz")
    numbers = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    sms = ffsms.load("planar_3r")
    end = sms.at(plan.q[-1]).end_effector_pose.translation
    assert numbers["reached"] is plan.reached is True
    assert numbers["final_error_m"] == pytest.approx(np.linalg.norm(end - [0.75, 0.5, 0.0]), abs=1e-13)
    assert numbers["cost_integral_s"] == pytest.approx(float(np.sum(plan.cost)) * 0.05)
    assert numbers["tracking"]["final_error_m"] == tracking.position_error[-1]
    torques = [joint["tracking_torque_max_Nm"] for joint in numbers["joints"]]
    assert torques == np.abs(tracking.tau).max(axis=0).tolist()
    assert numbers["versions"]["ffsms_pin"] == ffsms.__version__

    captured = capsys.readouterr()
    assert _ended(captured.err) == ["planning", "tracking", "figures"]
    for word in ("reached", "cost integral", "joint_3", "base rotation", "per control step", str(out)):
        assert word in captured.out
    assert "planar_3r, planned by the method 'horizon'" in captured.out.splitlines()[0]
    assert captured.out.splitlines()[-1] == f"arrived; to see the motion: ffsms-pin view {out}"
    assert f"{1e3 * numbers['final_error_m']:.3g} mm" in captured.out


def test_a_run_replaces_only_its_own_files_of_an_existing_folder(
    quick: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    out = tmp_path / "results" / "quick"  # the default
    out.mkdir(parents=True)
    (out / "notes.txt").write_text("mine")
    (out / "summary.json").write_text("old")
    assert main(["run", "quick.toml", "--no-figures"]) == 0
    assert {path.name for path in out.iterdir()} == NUMBERS | {"notes.txt"}
    assert (out / "notes.txt").read_text() == "mine"
    assert json.loads((out / "summary.json").read_text())["scenario"] == "quick"


def test_a_target_that_is_not_reached(
    tmp_path: Path, quick: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    quick.write_text(COARSE.replace("[0.75, 0.5, 0.0]", "[3.0, 0.0, 0.0]"))
    assert main(["run", str(quick), "--out", str(tmp_path / "far"), "--no-figures"]) == 1
    numbers = json.loads((tmp_path / "far" / "summary.json").read_text())
    assert numbers["reached"] is False
    assert numbers["final_error_m"] > 1.0
    assert {path.name for path in (tmp_path / "far").iterdir()} == NUMBERS
    printed = capsys.readouterr().out
    assert "no" in printed.split("reached")[1].splitlines()[0]
    assert printed.splitlines()[-1].startswith("not arrived: the plan does not reach its target: ends ")


def test_a_closed_loop_that_misses_the_target_has_not_arrived(
    quick: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With a wrong plant the plan reaches and the closed loop does not; with re-planning it does."""
    wrong = COARSE.replace("[control]", '[control]\nlaw = "computed-torque"').replace("3.0", "6.0")
    wrong += "[plant]\narm_mass = 3.0\nbase_mass = 0.5\n"
    quick.write_text(wrong)
    assert main(["run", str(quick), "--out", str(tmp_path / "once"), "--no-figures"]) == 1
    once = json.loads((tmp_path / "once" / "summary.json").read_text())
    assert once["reached"] is True
    assert once["tracking"]["arrived"] is False
    printed = capsys.readouterr().out
    assert "arm_mass 3, base_mass 0.5" in " ".join(printed.split())
    assert printed.splitlines()[-1].startswith("not arrived: the end effector ends ")

    quick.write_text(wrong + '[reference]\nkind = "re-planning"\n')
    assert main(["run", str(quick), "--out", str(tmp_path / "again"), "--no-figures"]) == 0
    again = json.loads((tmp_path / "again" / "summary.json").read_text())
    assert again["tracking"]["arrived"] is True
    assert again["tracking"]["open_loop"]["final_error_m"] == pytest.approx(once["tracking"]["final_error_m"])
    captured = capsys.readouterr()
    first, second = captured.out.splitlines()[4:6]  # of the table, after its title and head
    assert "final error, re-planned" in first
    assert "final error, planned once" in second
    assert f"{1e3 * once['tracking']['final_error_m']:.3g} mm" in second
    stages = _ended(captured.err)
    assert stages == ["planning", "tracking", "plan once"]


@pytest.mark.slow
def test_the_module_runs_in_a_separate_process(quick: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-W", "error", "-m", "ffsms_pin"]
    done = subprocess.run(
        [*command, "run", "quick.toml", "--out", "out", "--no-figures"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert {path.name for path in (tmp_path / "out").iterdir()} == NUMBERS
    assert "\x1b" not in done.stdout + done.stderr  # no colours or bars outside a terminal
    again = subprocess.run(
        [*command, "run", "absent.toml"], cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert again.returncode == 2
    assert again.stderr.count("\n") == 1
    assert again.stderr.startswith("ffsms-pin: error: scenario absent.toml: there is no such file")
