"""Test the output of `info`, `--help` and `--version`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import ffsms_pin as ffsms
from ffsms_pin.cli import main
from ffsms_pin.cli.main import command_names


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


def test_info_refuses_options_of_a_robot_for_a_client(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    inertia = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    link = f'<link name="body"><inertial><mass value="5"/>{inertia}</inertial></link>'
    (tmp_path / "client.urdf").write_text(f'<robot name="client">{link}</robot>', encoding="utf-8")
    client = str(tmp_path / "client.urdf")
    assert main(["info", client]) == 0
    assert "one rigid body of 5 kg, a client" in capsys.readouterr().out
    for option, value in (("--joints-deg", "1"), ("--end-effector", "body")):
        assert main(["info", client, option, value]) == 2
        assert f"{option} needs a robot, but no joint of '{client}' moves" in capsys.readouterr().err


def test_info_shows_the_robot_of_an_mjcf_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = str(tmp_path / "robot.xml")
    assert main(["export", "planar_3r", "--mjcf", file]) == 0
    assert main(["info", file, "--joints-deg", "1", "1", "1"]) == 0
    assert "32.72" in capsys.readouterr().out
    assert main(["info", file, "--repair", str(tmp_path / "out.urdf")]) == 2
    assert "is not a URDF" in capsys.readouterr().err


def test_help_and_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    out = capsys.readouterr().out
    for word in ("ffsms-pin run case-2", "ffsms-pin info planar_3r", "run", "info", "exit codes"):
        assert word in out
    commands = ["run", "compare", "campaign", "scenario", "info", "view", "export"]
    assert command_names() == commands
    for command in commands:
        assert main([command, "--help"]) == 0
        assert f"ffsms-pin {command} " in capsys.readouterr().out.partition("example")[2]
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"ffsms-pin {ffsms.__version__}\n"


def test_help_loads_no_slow_module(tmp_path: Path) -> None:
    code = (
        "import sys; from ffsms_pin.cli import main; main(['--help']); "
        "print([x for x in ('matplotlib', 'rich') if x in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert done.stderr == "[]\n"


def test_the_error_for_two_end_effectors_names_the_option(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", "two_arms"]) == 2
    printed = capsys.readouterr().err
    assert "left_tool, right_tool" in printed
    assert "--end-effector NAME" in printed
    assert "load(" not in printed
