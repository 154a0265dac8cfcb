"""Test reports of `inspect`, files of `repair`, their arguments, and `ffsms-pin info`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from broken_urdfs import LIMIT_2, PLANAR, in_joint_2, in_link_2, limits, write

import ffsms_pin as ffsms
from ffsms_pin.cli import main
from ffsms_pin.errors import FfsmsError, InvalidUrdf, InvalidValue, ModelNotFound, ResultError
from ffsms_pin.inspection import inspect, repair
from ffsms_pin.inspection.faults import mended_number
from ffsms_pin.urdf import model_names

Refused = Callable[..., FfsmsError]
PI = np.pi


def test_repair_changes_faults_only(tmp_path: Path) -> None:
    path, out = write(tmp_path, in_joint_2('effort="1.5"', 'effort="1.5 "')), tmp_path / "out.urdf"
    assert len(repair(path, out)) == 1
    assert ffsms.load(out).model == ffsms.load("planar_3r").model
    mended = ffsms.load(out).geometry("visual")
    assert mended.ngeoms == 4
    assert "Das, Choi" not in out.read_text()  # a comment before the <robot> element is not kept
    assert "The frame at the tip of the third link" in out.read_text()


@pytest.mark.parametrize("name", model_names())
def test_packaged_robots_have_no_faults(name: str) -> None:
    report = inspect(name)
    assert report.loads
    assert report.faults == ()
    assert all(link.verdict in ("valid", "frame") for link in report.links)
    assert all(joint.velocity for joint in report.joints if joint.type == "revolute")


def test_the_report_lists_links_joints_and_faults(tmp_path: Path) -> None:
    path = write(tmp_path, in_link_2('<box size="0.3 0.03 0.03"/>', '<mesh filename="package://a/b.stl"/>'))
    report = inspect(path)
    assert report.name == "planar_3r"
    assert report.loads  # meshes are not needed for the dynamics
    (fault,) = report.faults
    assert not fault.blocks
    assert "b.stl" in fault.problem
    link = next(link for link in report.links if link.name == "link_2")
    assert (link.mass, link.principal_inertias) == (0.569, (0.0001, 0.0043, 0.0043))
    assert [link.verdict for link in report.links] == ["valid"] * 4 + ["frame"]
    joint = report.joints[0]
    assert (joint.name, joint.type, joint.effort) == ("joint_1", "revolute", "3.5")
    capsule = write(tmp_path, in_link_2('<box size="0.3 0.03 0.03"/>', '<capsule radius="1" length="2"/>'))
    assert ["capsule" in str(fault) for fault in inspect(capsule).faults] == [True]
    continuous = write(tmp_path, in_joint_2('"revolute"', '"continuous"').replace(LIMIT_2, "", 1))
    assert ["rate limit" in str(fault) for fault in inspect(continuous).faults] == [True]


def test_mesh_paths_are_relative_to_the_repaired_file(tmp_path: Path) -> None:
    (tmp_path / "arm.stl").write_text("a mesh")
    path = write(tmp_path, in_link_2('<box size="0.3 0.03 0.03"/>', '<mesh filename="arm.stl"/>'))
    (tmp_path / "new").mkdir()
    (change,) = repair(path, tmp_path / "new" / "out.urdf")
    assert "'../arm.stl'" in change.remedy
    assert inspect(tmp_path / "new" / "out.urdf").faults == ()


def test_equal_changes_are_all_listed(tmp_path: Path) -> None:
    flat = in_link_2('<box size="0.3 0.03 0.03"', '<box size="0.3 0 0.03"')
    shape = flat[flat.index("<visual>", flat.index('<link name="link_2">')) :]
    shape = shape[: shape.index("</visual>") + len("</visual>")]
    path = write(tmp_path, flat.replace(shape, shape + shape))
    assert len(repair(path, tmp_path / "out.urdf")) == 2


def test_limits_for_joints_without_any(tmp_path: Path) -> None:
    path, out = write(tmp_path, in_joint_2(LIMIT_2, "")), tmp_path / "out.urdf"
    (change,) = repair(path, out, rate=0.1, effort=7.0)
    assert limits(ffsms.load(out)) == [-PI, PI, 0.1, 7.0]
    assert "0.1 rad/s" in change.remedy
    assert "7 N m" in change.remedy


def test_bad_arguments(refused: Refused, tmp_path: Path) -> None:
    path, out = write(tmp_path, PLANAR), tmp_path / "out.urdf"
    nothing: Any = 3
    refused(lambda: inspect(tmp_path / "none.urdf"), ModelNotFound, "none.urdf")
    refused(lambda: inspect(nothing), InvalidValue, "path")
    refused(lambda: repair(path, nothing), InvalidValue, "out")
    refused(lambda: repair(path, out, rate=0.0), InvalidValue, "rate")
    refused(lambda: repair(path, out, effort=-1.0), InvalidValue, "effort")
    refused(lambda: repair(path, tmp_path / "no" / "out.urdf"), ResultError, "out.urdf")
    refused(lambda: inspect(write(tmp_path, "<html/>")), InvalidUrdf, "<html>")


@pytest.mark.parametrize(
    ("text", "value"),
    [("1.5", "1.5"), (" 1.5\t", "1.5"), ("1,5", "1.5"), ("2*(1+0.5)", "3.0"), ("-pi", repr(-PI)),
     ("math.pi/3", repr(PI / 3)), ("${pi / 2}", repr(PI / 2)), ("+M_PI", repr(PI))],
)  # fmt: skip
def test_numbers_that_can_be_repaired(text: str, value: str) -> None:
    assert mended_number(text) == value


@pytest.mark.parametrize(
    "text",
    ["", " ", "1 2", "half", "1/0", "1kg", "2**9", "nan", "1e999", "9" * 400, "(" * 90, "__import__('os')",
     "pi.real", "True", "1 if 1 else 2", "[1]", "\u0663", "1,000,5", "a\0b", "${x}", "1_0j"],
)  # fmt: skip
def test_numbers_that_cannot_be_repaired(text: str) -> None:
    assert mended_number(text) is None


def test_info_lists_the_faults_and_repairs_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", "planar_3r"]) == 0
    assert "Faults" not in capsys.readouterr().out
    path, out = write(tmp_path, in_joint_2('velocity="0.40002946455710037" ', "")), tmp_path / "out.urdf"
    assert main(["info", str(path)]) == 1
    shown = capsys.readouterr().out
    for word in ("does not load", "link_3", "0.0043", "joint_2", "--repair OUT"):
        assert word in shown
    assert (
        main(["info", str(path), "--repair", str(out), "--rate", "0.2", "--joints-deg", "1", "2", "3"]) == 0
    )
    shown = capsys.readouterr().out
    for word in ("1 change:", "velocity limit set to 0.2 rad/s", "(1 deg, 2 deg, 3 deg)"):
        assert word in shown
    assert ffsms.load(out).n == 3


@pytest.mark.parametrize(
    ("arguments", "fragment"),
    [
        (["BROKEN", "--repair", "OUT"], "cannot be repaired"),
        (["BROKEN", "--rate", "0.2"], "--rate needs --repair OUT, because it is for the repaired file"),
        (
            ["satellite_ur5", "--repair", "OUT"],
            "MODEL must be a URDF file if --repair is given, got 'satellite_ur5'",
        ),
        (["none.urdf", "--repair", "OUT"], "no robot 'none.urdf'"),
    ],
)
def test_files_that_info_cannot_repair(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], fragment: str
) -> None:
    broken, out = write(tmp_path, PLANAR.replace("31.015", "-1")), tmp_path / "out.urdf"
    names = {"BROKEN": str(broken), "OUT": str(out)}
    assert main(["info", *(names.get(word, word) for word in arguments)]) == 2
    assert fragment in capsys.readouterr().err
    assert not out.exists()
