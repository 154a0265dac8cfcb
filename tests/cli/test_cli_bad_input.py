"""Test that errors of commands and their files print one line and leave no files."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from scenario_files import COARSE

from ffsms_pin.cli import main
from ffsms_pin.urdf import model_path


@pytest.fixture
def fails(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., str]:
    """Return a function that runs a command and checks exit code 2, a one-line error and no new files."""
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


@pytest.mark.parametrize(
    ("line", "replacement", "fragments"),
    [
        ("[robot]", "[robot", ["quick.toml", "not a TOML file", "line 1"]),
        ("duration", "durration", ["quick.toml", "'durration'", "[plan]", "did you mean 'duration'"]),
        ("[plan]", "[plann]", ["[plann]", "did you mean 'plan'"]),
        ("[0.75, 0.5, 0.0]", "[0.75, 0.5]", ["[target] position", "3 numbers"]),
        ("[0.75, 0.5, 0.0]", "[0.75, nan, 0.0]", ["[target] position", "finite", "nan"]),
        ("duration = 3.0", "duration = 0.0", ["[plan] duration", "above zero"]),
        ("dt = 0.05", "dt = 4.0", ["quick.toml", "duration", "at least one step of 4 s"]),
        ("[23.0, 40.0, -29.0]", "[23.0, 40.0]", ["[start] joints_deg", "3 joints", "got 2"]),
        ("[23.0, 40.0, -29.0]", "[99.0, 40.0, -29.0]", ["joint_1", "99 deg", "[-81, 81] deg"]),
        ("planar_3r", "planar_4r", ["planar_4r", "packaged: "]),
        ("planar_3r", "quick.toml", ["quick.toml", "cannot be read as XML"]),
        ('"planar_3r"', '"planar_3r"\nend_effector = "hand"', ["no frame 'hand'", "end_effector"]),
        ("[control]", "[control]\nK_s = [1, 2]", ["quick.toml", "K_s", "(3, 3)"]),
        ("[control]", "[limits]\nupper_deg = -99\n[control]", ["joint 1", "wrong order"]),
        ("[control]", "[control]\nlaw = 'pd'\nK_p = [[1,2,0],[2,1,0],[0,0,1]]", ["K_p", "definite"]),
        ("[control]", "[plant]\nmodel = 'space_arm_7'\n[control]", ["plant", "joint_1, joint_2, joint_3"]),
        ("[control]", "[actuator]\ndelay = 3.5\n[control]", ["[actuator] delay", "duration of 3 s"]),
        ("[control]", "[[fault]]\ntime = 1\njoint = 'j'\n[control]", ["[[fault]] 1 joint", "'j'"]),
        ("[control]", "[friction]\nviscus = 1\n[control]", ["did you mean 'viscous'"]),
    ],
)
def test_bad_input(
    quick: Path, fails: Callable[..., str], line: str, replacement: str, fragments: list[str]
) -> None:
    assert line in COARSE
    quick.write_text(COARSE.replace(line, replacement, 1))
    error = fails("run", quick)
    for word in fragments:
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
    quick.write_text(COARSE.replace("planar_3r", "empty.urdf"))
    error = fails("run", quick)
    assert "empty.urdf" in error
    assert "no inertia" in error


def test_an_out_that_cannot_be_written(fails: Callable[..., str], quick: Path) -> None:
    assert "is a file" in fails("run", quick, "--out", quick)
    assert "cannot be written" in fails("run", quick, "--out", quick / "below" / "a file")
    assert "must name a folder" in fails("run", quick, "--out", "")
    # The name is too long for the file system.
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
        ([], "name a command"),
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


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("compare", "case-1", "--methods", "horizn"), "--methods must be one of"),
        (("campaign", "case-1", "--runs", "0"), "--runs must be a whole number"),
        (("view", ".", "--end-effector", "tip"), "--end-effector requires a robot in --robot"),
        (("scenario", "--shema"), "unknown argument '--shema'; did you mean '--schema'?"),
    ],
)
def test_errors_name_arguments_as_typed(
    fails: Callable[..., str], arguments: tuple[str, ...], message: str
) -> None:
    assert f"error: {message}" in fails(*arguments)


def test_advice_of_commands_names_options_and_scenario_keys(
    fails: Callable[..., str], quick: Path, tmp_path: Path
) -> None:
    still = re.sub('velocity="[^"]*"', 'velocity="0"', model_path("planar_3r").read_text())
    (tmp_path / "still.urdf").write_text(still)
    message = fails("export", "still.urdf", "--urdf", "x.urdf")
    assert "ffsms-pin info FILE --repair OUT" in message
    assert "load(" not in message
    quick.write_text(COARSE.replace('"planar_3r"', '"still.urdf"'))
    assert "[robot] velocity = ... sets it for all joints" in fails("run", quick)
    round_base = model_path("planar_3r").read_text().replace('<box size="', '<sphere radius="0.2" was="')
    (tmp_path / "round.urdf").write_text(round_base)
    quick.write_text(COARSE.replace('"planar_3r"', '"round.urdf"'))
    assert "[robot] base_size = [l, w, h]" in fails("run", quick)
    for key, table in (("joints", "start"), ("offset", "control")):
        far = {"start": "[99.0, 40.0, -29.0]", "control": "[0, 0, 200.0]"}[table]
        text = (
            COARSE.replace("[23.0, 40.0, -29.0]", far) if table == "start" else f"{COARSE}{key}_deg = {far}\n"
        )
        quick.write_text(text)
        assert f"[{table}] {key}_deg puts joint" in fails("run", quick)
    quick.write_text(COARSE)
    assert "[robot] end_effector" in fails("export", quick, "--urdf", "x.urdf", "--end-effector", "tip")
