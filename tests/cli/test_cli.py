"""The command line end to end: results, tables, exit codes, and one line for whatever is wrong."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from scenario_files import IN_DEGREES

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.cli import main
from ffsms_pin.cli.progress import shown_progress
from ffsms_pin.cli.results_folder import results_folder
from ffsms_pin.errors import ResultError
from ffsms_pin.plotting import FIGURES
from ffsms_pin.simulation import Tracking

QUICK = f"""{IN_DEGREES.lstrip()}\
[plan]
duration = 3.0
dt = 0.05
[control]
dt = 0.01
"""
NUMBERS = {"trajectory.npz", "tracking.npz", "scenario.json", "summary.json"}
ALL = NUMBERS | {f"{name}.{ending}" for name in FIGURES for ending in ("pdf", "png")}


@pytest.fixture
def quick(tmp_path: Path) -> Path:
    path = tmp_path / "quick.toml"
    path.write_text(QUICK)
    return path


@pytest.fixture
def fails(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., str]:
    """Runs the command line and checks: exit code 2, one line on the error stream, nothing new on disk."""
    monkeypatch.chdir(tmp_path)

    def check(*arguments: object) -> str:
        before = sorted(tmp_path.rglob("*"))
        code = main([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        assert code == 2
        assert captured.out == ""
        assert captured.err.startswith("ffsms-pin: error: ")
        assert captured.err.endswith("\n")
        assert captured.err.count("\n") == 1
        assert "Traceback" not in captured.err
        assert sorted(tmp_path.rglob("*")) == before
        return captured.err

    return check


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
    assert [line.split(":")[0] for line in captured.err.splitlines()] == ["planning", "tracking", "figures"]
    for word in ("reached", "cost integral", "joint_3", "base rotation", "per control step", str(out)):
        assert word in captured.out
    assert f"{1e3 * numbers['final_error_m']:.3g} mm" in captured.out


def test_run_into_a_folder_that_is_there_replaces_its_own_files_only(
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
    quick.write_text(QUICK.replace("[0.75, 0.5, 0.0]", "[3.0, 0.0, 0.0]"))
    assert main(["run", str(quick), "--out", str(tmp_path / "far"), "--no-figures"]) == 1
    numbers = json.loads((tmp_path / "far" / "summary.json").read_text())
    assert numbers["reached"] is False
    assert numbers["final_error_m"] > 1.0
    assert {path.name for path in (tmp_path / "far").iterdir()} == NUMBERS
    assert "no" in capsys.readouterr().out.split("reached")[1].splitlines()[0]


def test_a_closed_loop_that_ends_elsewhere_is_not_reached_either(
    quick: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A heavy arm on a light base: the plan reaches, what follows it does not; planned again, it does."""
    wrong = QUICK.replace("[control]", '[control]\nlaw = "computed-torque"').replace("3.0", "5.0")
    wrong += "[plant]\narm_mass = 3.0\nbase_mass = 0.5\n"
    quick.write_text(wrong)
    assert main(["run", str(quick), "--out", str(tmp_path / "once"), "--no-figures"]) == 1
    once = json.loads((tmp_path / "once" / "summary.json").read_text())
    assert once["reached"] is True
    assert once["tracking"]["arrived"] is False
    assert "arm_mass 3, base_mass 0.5" in " ".join(capsys.readouterr().out.split())

    quick.write_text(wrong + '[reference]\nkind = "re-planning"\n')
    assert main(["run", str(quick), "--out", str(tmp_path / "again")]) == 0
    again = json.loads((tmp_path / "again" / "summary.json").read_text())
    assert again["tracking"]["arrived"] is True
    assert again["tracking"]["open_loop"]["final_error_m"] == pytest.approx(once["tracking"]["final_error_m"])
    assert {path.name for path in (tmp_path / "again").iterdir()} == ALL
    captured = capsys.readouterr()
    assert "the same, plan made once" in captured.out
    assert f"{1e3 * once['tracking']['final_error_m']:.3g} mm" in captured.out
    stages = [line.split(":")[0] for line in captured.err.splitlines()]
    assert stages == ["planning", "tracking", "plan once", "figures"]


def test_as_a_module_in_a_process_of_its_own(quick: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-W", "error", "-m", "ffsms_pin"]
    done = subprocess.run(
        [*command, "run", "quick.toml", "--out", "out"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert {path.name for path in (tmp_path / "out").iterdir()} == ALL
    assert "\x1b" not in done.stdout + done.stderr  # no colours or bars outside a terminal
    again = subprocess.run(
        [*command, "run", "absent.toml"], cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    assert again.returncode == 2
    assert again.stderr.count("\n") == 1
    assert again.stderr.startswith("ffsms-pin: error: scenario absent.toml: there is no such file")


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_interrupted(tmp_path: Path, quick: Path) -> None:
    quick.write_text(QUICK.replace("dt = 0.05", "dt = 0.0005").replace("duration = 3.0", "duration = 300.0"))
    process = subprocess.Popen(
        [sys.executable, "-m", "ffsms_pin", "run", "quick.toml"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # A shell's background jobs ignore the signal, and hand that down.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    try:
        deadline = time.monotonic() + 60.0
        while not (tmp_path / "results").exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        time.sleep(0.3)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60.0)
    finally:
        process.kill()
    assert process.returncode == 130
    assert err.count("\n") == 1
    assert "interrupted" in err
    assert out == ""
    assert [path.name for path in tmp_path.iterdir()] == ["quick.toml"]


@pytest.mark.parametrize(
    ("line", "instead", "words"),
    [
        ("[robot]", "[robot", ["quick.toml", "not a TOML file", "line 1"]),
        ("duration", "durration", ["quick.toml", "'durration'", "[plan]", "did you mean 'duration'"]),
        ("[plan]", "[plann]", ["[plann]", "did you mean 'plan'"]),
        ("[0.75, 0.5, 0.0]", "[0.75, 0.5]", ["[target] position", "3 numbers"]),
        ("[0.75, 0.5, 0.0]", "[0.75, nan, 0.0]", ["[target] position", "finite", "nan"]),
        ("duration = 3.0", "duration = 0.0", ["[plan] duration", "above zero"]),
        ("duration = 3.0", "duration = -3.0", ["[plan] duration", "above zero", "-3.0"]),
        ("dt = 0.05", "dt = 0", ["[plan] dt", "above zero"]),
        ("dt = 0.05", "dt = -0.05", ["[plan] dt", "above zero", "-0.05"]),
        ("dt = 0.05", "dt = 4.0", ["quick.toml", "duration", "at least one step of 4 s"]),
        ("dt = 0.01", "dt = 0.0", ["[control] dt", "above zero"]),
        ("[23.0, 40.0, -29.0]", "[23.0, 40.0]", ["[start] joints_deg", "3 joints", "got 2"]),
        ("[23.0, 40.0, -29.0]", "[nan, 40.0, -29.0]", ["[start] joints_deg", "finite"]),
        ("[23.0, 40.0, -29.0]", "[99.0, 40.0, -29.0]", ["joint_1", "99 deg", "[-81, 81] deg"]),
        ("planar_3r", "planar_4r", ["planar_4r", "packaged: "]),
        ("planar_3r", "quick.toml", ["quick.toml", "not an XML file"]),
        ('"planar_3r"', '"planar_3r"\nend_effector = "hand"', ["no frame 'hand'", "end_effector"]),
        ('"planar_3r"', '"planar_3r"\nbase_size = [1, 2]', ["[robot] base_size", "3 numbers"]),
        ("[control]", "[control]\nGamma = 0", ["quick.toml", "Gamma", "above zero"]),
        ("[control]", "[control]\nK_s = [1, 2]", ["quick.toml", "K_s", "(3,)"]),
        ("[control]", "[limits]\nupper_deg = -99\n[control]", ["joint 1", "wrong way round"]),
        ("[control]", "[control]\nlaw = 'pd'\nK_p = [[1,2,0],[2,1,0],[0,0,1]]", ["K_p", "definite"]),
        ("[control]", "[plant]\nmodel = 'space_arm_7'\n[control]", ["plant", "joint_1, joint_2, joint_3"]),
        ("[control]", "[actuator]\ndelay = 3.5\n[control]", ["actuator.delay", "duration of 3 s"]),
        ("[control]", "[[fault]]\ntime = 1\njoint = 'j'\n[control]", ["fault.joint", "'j'"]),
        ("[control]", "[friction]\nviscus = 1\n[control]", ["did you mean 'viscous'"]),
    ],
)
def test_bad_input(quick: Path, fails: Callable[..., str], line: str, instead: str, words: list[str]) -> None:
    assert line in QUICK
    quick.write_text(QUICK.replace(line, instead, 1))
    error = fails("run", quick)
    for word in words:
        assert word in error


def test_a_missing_scenario_or_robot(fails: Callable[..., str], tmp_path: Path) -> None:
    assert "case-1, case-2" in fails("run", "case-9")
    assert "cannot be read" in fails("run", tmp_path)
    assert "planar_3r" in fails("info", "planar_9r")


def test_a_robot_without_inertia(fails: Callable[..., str], tmp_path: Path, quick: Path) -> None:
    (tmp_path / "empty.urdf").write_text(
        '<robot name="r"><link name="a"/><link name="b"/>'
        '<joint name="j" type="continuous"><parent link="a"/><child link="b"/>'
        '<limit velocity="1" effort="1"/></joint></robot>'
    )
    quick.write_text(QUICK.replace("planar_3r", "empty.urdf"))
    for arguments in (("run", quick), ("info", "empty.urdf")):
        error = fails(*arguments)
        assert "empty.urdf" in error
        assert "no inertia" in error


def test_an_out_that_cannot_be_written(fails: Callable[..., str], quick: Path) -> None:
    assert "is a file" in fails("run", quick, "--out", quick)
    assert "cannot be written" in fails("run", quick, "--out", quick / "below" / "a file")
    assert "must name a folder" in fails("run", quick, "--out", "")
    # A name that no file system takes.
    assert "cannot be written" in fails("run", quick, "--out", "x" * 300)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write everywhere")
def test_an_out_in_a_folder_without_permission(
    fails: Callable[..., str], quick: Path, tmp_path: Path
) -> None:
    locked = tmp_path / "locked"
    locked.mkdir(mode=0o500)
    assert "cannot be written" in fails("run", quick, "--out", locked / "results")
    assert "cannot be written" in fails("run", quick, "--out", locked)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ([], "COMMAND"),
        (["walk"], "walk"),
        (["run"], "SCENARIO"),
        (["run", "case-1", "--outt", "x"], "--outt"),
        (["info", "planar_3r", "--joints-deg", "one"], "one"),
    ],
)
def test_arguments_that_cannot_be_used(fails: Callable[..., str], arguments: list[str], word: str) -> None:
    error = fails(*arguments)
    assert word in error
    assert "--help" in error


def test_info_arguments_that_do_not_fit_the_robot(fails: Callable[..., str]) -> None:
    assert "--joints-deg" in fails("info", "planar_3r", "--joints-deg", "1", "2")
    assert "--joints-deg must be finite" in fails("info", "planar_3r", "--joints-deg", "1", "2", "nan")
    assert "no frame 'hand'" in fails("info", "planar_3r", "--end-effector", "hand")


def test_info(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", "planar_3r", "--joints-deg", "1", "1", "1"]) == 0
    out = capsys.readouterr().out
    state = (sms := ffsms.load("planar_3r")).at(sms.configuration(np.deg2rad([1.0, 1.0, 1.0])))
    for number in (
        "31.02",  # mass of the base, of a link, of all
        "0.569",
        "32.72",
        "-81 to 81 deg",
        "22.92 deg/s",
        "28.65 deg/s²",
        "3.5 N m",
        "-0.03557, -0.00064",
        f"{np.linalg.cond(state.H_b):.4g}",
        f"{state.coupling.entropy:.4f}",
        *(f"{sigma:.4g}" for sigma in np.linalg.svd(state.C_bm, compute_uv=False)),
    ):
        assert number in out, number


def test_info_takes_negative_angles_and_frames(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", "planar_3r", "--end-effector", "link_2", "--joints-deg", "-10", "20", "-30"]) == 0
    out = capsys.readouterr().out
    assert "end effector 'link_2'" in out
    assert "(-10 deg, 20 deg, -30 deg)" in out


def test_help_and_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    out = capsys.readouterr().out
    for word in ("ffsms-pin run case-2", "ffsms-pin info planar_3r", "run", "info", "exit codes"):
        assert word in out
    for command in ("run", "info", "compare", "laws", "robustness"):
        assert main([command, "--help"]) == 0
        assert f"example: ffsms-pin {command} " in capsys.readouterr().out
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"ffsms-pin {ffsms.__version__}\n"


def test_help_loads_nothing_heavy(tmp_path: Path) -> None:
    code = (
        "import sys; from ffsms_pin.cli import main; main(['--help']); "
        "print([x for x in ('matplotlib', 'rich') if x in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert done.stderr == "[]\n"


# -- the results folder and the progress ------------------------------------------------------------


@pytest.mark.parametrize("there", [False, True])
def test_a_failure_leaves_the_folder_as_it_was(tmp_path: Path, there: bool) -> None:
    out = tmp_path / "a" / "b" / "out"
    if there:
        out.mkdir(parents=True)
        (out / "old.txt").write_text("old")
    before = sorted(tmp_path.rglob("*"))

    def fill() -> None:
        with results_folder(out) as staging:
            (staging / "old.txt").write_text("new")
            raise RuntimeError("stopped")

    with pytest.raises(RuntimeError, match="stopped"):
        fill()
    assert sorted(tmp_path.rglob("*")) == before
    if there:
        assert (out / "old.txt").read_text() == "old"


def test_a_full_disk_is_one_line_too(tmp_path: Path) -> None:
    def fill() -> None:
        with results_folder(tmp_path / "out"):
            raise OSError(28, "No space left on device")

    with pytest.raises(ResultError, match=r"out: cannot be written \(No space left on device\)"):
        fill()
    assert list(tmp_path.iterdir()) == []


def test_a_folder_through_a_link_is_filled_where_it_is(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real", target_is_directory=True)
    with results_folder(tmp_path / "link") as staging:
        (staging / "a").write_text("1")
    assert (tmp_path / "link").is_symlink()
    assert [path.name for path in (tmp_path / "real").iterdir()] == ["a"]


def test_a_terminal_gets_bars() -> None:
    console = Console(force_terminal=True, record=True, width=80, file=open(os.devnull, "w"))  # noqa: SIM115
    with shown_progress(console) as progress:
        for stage in ("planning", "tracking"):
            for share in (0.0, 0.5, 1.0):
                progress(stage, share)
    console.file.close()
    text = console.export_text()
    assert "planning" in text
    assert "100%" in text
