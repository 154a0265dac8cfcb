"""What `inspect` finds in damaged files, and that `repair` mends them and says so."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import ffsms_pin as ffsms
from ffsms_pin.cli.inspect_command import add_parser, run
from ffsms_pin.errors import FfsmsError, FfsmsWarning, InvalidUrdf, InvalidValue, ModelNotFound, ResultError
from ffsms_pin.inspection import inspect, repair
from ffsms_pin.inspection.numbers import mended_number
from ffsms_pin.urdf import model_names, model_path

Refused = Callable[..., FfsmsError]
PLANAR = model_path("planar_3r").read_text()
JOINT_2 = PLANAR.index('<joint name="joint_2"')
LIMIT = re.compile(r"<limit lower[^>]*/>")
BOUNDS = 'lower="-2.827433388230814" upper="2.827433388230814"'
LIMIT_2 = str(LIMIT.findall(PLANAR)[1])


def in_link_2(old: str, new: str) -> str:
    start = PLANAR.index('<link name="link_2">')
    assert old in PLANAR[start:]
    return PLANAR[:start] + PLANAR[start:].replace(old, new, 1)


def in_joint_2(old: str, new: str) -> str:
    assert old in PLANAR[JOINT_2:]
    return PLANAR[:JOINT_2] + PLANAR[JOINT_2:].replace(old, new, 1)


def write(folder: Path, text: str) -> Path:
    path = folder / "broken.urdf"
    path.write_text(text, encoding="utf-8")
    return path


def body(sms: ffsms.SpaceManipulator, joint: str) -> Any:
    return sms.model.inertias[sms.model.getJointId(joint)]


def limits(sms: ffsms.SpaceManipulator) -> list[float]:
    given = sms.limits
    return [float(x[1]) for x in (given.lower, given.upper, given.velocity, given.torque)]


PI = np.pi
USUAL = [-2.827433388230814, 2.827433388230814, 0.40002946455710037, 1.5]
# What is wrong, where the report has to see it, and what the mended robot has to be like.
MENDED: dict[str, tuple[str, str, str, Callable[[ffsms.SpaceManipulator], bool]]] = {
    "blank": (
        in_link_2('<mass value="0.569"/>', '<mass value="0.569 "/>'),
        "link 'link_2'",
        '"0.569 "',
        lambda sms: body(sms, "joint_2").mass == 0.569,
    ),
    "decimal comma": (
        in_link_2('<mass value="0.569"/>', '<mass value="0,569"/>'),
        "link 'link_2'",
        "0,569",
        lambda sms: body(sms, "joint_2").mass == 0.569,
    ),
    "formula": (
        in_joint_2('upper="2.827433388230814"', 'upper="pi/2"'),
        "joint 'joint_2'",
        "pi/2",
        lambda sms: limits(sms)[1] == PI / 2,
    ),
    "formulas in a place": (
        in_joint_2('rpy="0 0 0"', 'rpy="0 -${pi/4} pi"').replace("-${pi/4}", "${-pi/4}"),
        "joint 'joint_2'",
        "rpy",
        lambda sms: abs(sms.model.jointPlacements[3].rotation[2, 0] - np.sin(PI / 4)) < 1e-12,
    ),
    "commas in a place": (
        in_joint_2('xyz="0.3 0 0"', 'xyz="0.3, 0, 0"'),
        "joint 'joint_2'",
        "xyz",
        lambda sms: sms.model.jointPlacements[3].translation[0] == 0.3,
    ),
    "infinite torque": (
        in_joint_2('effort="1.5"', 'effort="inf"'),
        "joint 'joint_2'",
        "effort",
        lambda sms: limits(sms)[3] == np.inf,
    ),
    "no name": (
        PLANAR.replace('<robot name="planar_3r">', "<robot>"),
        "robot",
        "name",
        lambda sms: sms.model.name == "broken",
    ),
    "no limit": (
        in_joint_2(LIMIT_2, ""),
        "joint 'joint_2'",
        "<limit>",
        lambda sms: limits(sms) == [-PI, PI, 0.5, 100.0],
    ),
    "no bounds": (
        in_joint_2(BOUNDS, ""),
        "joint 'joint_2'",
        "neither",
        lambda sms: limits(sms) == [-PI, PI, *USUAL[2:]],
    ),
    "no velocity": (
        in_joint_2('velocity="0.40002946455710037" ', ""),
        "joint 'joint_2'",
        "velocity",
        lambda sms: limits(sms)[2] == 0.5,
    ),
    "zero effort": (
        in_joint_2('effort="1.5"', 'effort="0"'),
        "joint 'joint_2'",
        "effort",
        lambda sms: limits(sms)[3] == 100.0,
    ),
    "wrong way round": (
        in_joint_2(BOUNDS, 'lower="2" upper="-1"'),
        "joint 'joint_2'",
        "wrong way round",
        lambda sms: limits(sms)[:2] == [-1.0, 2.0],
    ),
    "no room": (
        in_joint_2(BOUNDS, 'lower="0.3" upper="0.3"'),
        "joint 'joint_2'",
        "no room",
        lambda sms: sms.joint_names == ["joint_1", "joint_3"],
    ),
    "mimic": (
        in_joint_2("<limit", '<mimic joint="joint_1" offset="0.2"/><limit'),
        "joint 'joint_2'",
        "mimics",
        lambda sms: sms.joint_names == ["joint_1", "joint_3"],
    ),
    "empty dynamics": (
        in_joint_2("<limit", "<dynamics/><limit"),
        "joint 'joint_2'",
        "dynamics",
        lambda sms: sms.n == 3,
    ),
    "triangle": (
        in_link_2('ixx="0.0001"', 'ixx="0.01"'),
        "link 'link_2'",
        "triangle",
        # Second moments (-0.0007, 0.005, 0.005): the negative one becomes zero.
        lambda sms: bool(np.abs(body(sms, "joint_2").inertia - np.diag([0.01, 0.005, 0.005])).max() < 1e-15),
    ),
    "not positive definite": (
        in_link_2('iyz="0"', 'iyz="0.01"'),
        "link 'link_2'",
        "positive definite",
        lambda sms: bool(np.linalg.eigvalsh(body(sms, "joint_2").inertia)[0] > 0.0),
    ),
    "point mass": (
        in_link_2('ixx="0.0001" ixy="0" ixz="0" iyy="0.0043" iyz="0" izz="0.0043"',
                  'ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"'),
        "link 'link_2'",
        "positive definite",
        # A sphere of 0.569 kg of aluminium: 2.107e-4 m^3, a radius of 36.9 mm.
        lambda sms: bool(np.abs(body(sms, "joint_2").inertia - 3.1e-4 * np.eye(3)).max() < 0.01e-4),
    ),
    "thin rod": (
        in_link_2('ixx="0.0001"', 'ixx="0"'),
        "link 'link_2'",
        "positive definite",
        lambda sms: 0.0 < body(sms, "joint_2").inertia[0, 0] < 1e-7,
    ),
    "no tensor": (
        in_link_2('<inertia ixx="0.0001" ixy="0" ixz="0" iyy="0.0043" iyz="0" izz="0.0043"/>', ""),
        "link 'link_2'",
        "no <inertia>",
        lambda sms: bool(np.linalg.eigvalsh(body(sms, "joint_2").inertia)[0] > 0.0),
    ),
    "no products": (
        in_link_2(' ixy="0" ixz="0"', ""),
        "link 'link_2'",
        "ixy, ixz",
        lambda sms: body(sms, "joint_2").inertia[1, 1] == 0.0043,
    ),
    "moving tip without mass": (
        PLANAR.replace('<joint name="tip" type="fixed">', f'<joint name="tip" type="revolute">{LIMIT_2}'),
        "joint 'tip'",
        "no mass",
        lambda sms: sms.n == 3,
    ),
    "flat box": (
        in_link_2('<box size="0.3 0.03 0.03"', '<box size="0.3 0 0.03"'),
        "link 'link_2'",
        "box",
        lambda sms: sms.geometry("visual").ngeoms == 3,
    ),
    "world link": (
        PLANAR.replace(
            '<link name="base">',
            '<link name="world"/><joint name="float" type="floating">'
            '<parent link="world"/><child link="base"/></joint><link name="base">',
        ),
        "joint 'float'",
        "float",
        lambda sms: sms.n == 3,
    ),
    "two faults, one behind the other": (
        in_link_2('<mass value="0.569"/>', '<mass value=" 0.569"/>').replace(LIMIT_2, "", 1),
        "link 'link_2'",
        '" 0.569"',
        lambda sms: sms.n == 3,
    ),
}  # fmt: skip


LENIENT = {"no limit", "mimic"}  # `load` assumes the same as a repair, with a warning


@pytest.mark.parametrize("case", MENDED)
def test_faults_are_found_and_mended(case: str, tmp_path: Path) -> None:
    text, where, words, as_wanted = MENDED[case]
    path, out = write(tmp_path, text), tmp_path / "mended.urdf"
    lenient = case in LENIENT
    if lenient:
        with pytest.warns(FfsmsWarning, match=where.split()[1]):
            assert as_wanted(ffsms.load(path))
    else:
        with pytest.raises(FfsmsError):
            ffsms.load(path)
    report = inspect(path)
    assert report.loads is lenient
    assert bool(report.refusal) is not lenient
    assert report.repairable
    faults = [fault for fault in report.faults if fault.where == where and words in fault.problem]
    assert faults
    assert faults[0].blocks is not lenient
    assert faults[0].remedy
    assert path.read_text(encoding="utf-8") == text

    changes = repair(path, out)
    assert path.read_text(encoding="utf-8") == text
    assert {change.where for change in changes} >= {where}
    # Every change is listed, in the file too, and nothing else is different.
    mended = out.read_text(encoding="utf-8")
    for change in changes:
        assert str(change).replace("--", "- -").replace("<", "&lt;") in mended.replace("<", "&lt;")
    sms = ffsms.load(out)
    assert as_wanted(sms)
    again = inspect(out)
    assert again.loads
    assert not [fault for fault in again.faults if fault.blocks]
    assert repair(out, tmp_path / "again.urdf") == []


def test_only_what_is_wrong_is_changed(tmp_path: Path) -> None:
    path, out = write(tmp_path, in_joint_2('effort="1.5"', 'effort="1.5 "')), tmp_path / "out.urdf"
    assert len(repair(path, out)) == 1
    assert ffsms.load(out).model == ffsms.load("planar_3r").model
    mended = ffsms.load(out).geometry("visual")
    assert mended.ngeoms == 4
    assert "Das, Choi" not in out.read_text()  # a comment before the <robot> element is not kept
    assert "A frame, not a body" in out.read_text()


STUCK: dict[str, tuple[str, tuple[str, ...]]] = {
    "negative mass": (in_link_2('<mass value="0.569"/>', '<mass value="-0.569"/>'), ("link_2", "negative")),
    "mass in words": (in_link_2('<mass value="0.569"/>', '<mass value="half"/>'), ("link_2", "half")),
    "NaN": (in_link_2('iyy="0.0043"', 'iyy="nan"'), ("link_2", "nan")),
    "no mass": (in_link_2('<mass value="0.569"/>', ""), ("link_2", "<mass>")),
    "massless link inside": (in_link_2('<mass value="0.569"/>', '<mass value="0"/>'), ("link_2", "no mass")),
    "base without mass": (PLANAR.replace("31.015", "0"), ("base", "mount")),
    "no izz": (in_link_2(' izz="0.0043"', ""), ("link_2", "izz")),
    "zero axis": (in_joint_2('<axis xyz="0 0 1"', '<axis xyz="0 0 0"'), ("joint_2", "axis")),
    "floating joint inside": (in_joint_2('"revolute"', '"floating"'), ("joint_2", "floating")),
    "ball joint": (in_joint_2('"revolute"', '"ball"'), ("joint_2", "ball")),
    "two roots": (PLANAR.replace("</robot>", '<link name="debris"/></robot>'), ("debris",)),
    "unknown child": (in_joint_2('child link="link_2"', 'child link="lnk"'), ("lnk",)),
    "nothing moves": (PLANAR.replace('"revolute"', '"fixed"'), ("no joint that moves",)),
}


@pytest.mark.parametrize("case", STUCK)
def test_what_cannot_be_mended_is_said(refused: Refused, case: str, tmp_path: Path) -> None:
    text, words = STUCK[case]
    path, out = write(tmp_path, text), tmp_path / "out.urdf"
    report = inspect(path)
    assert not report.loads
    assert not report.repairable
    stuck = [fault for fault in report.faults if fault.blocks and fault.remedy is None]
    assert stuck
    for word in words:
        assert any(word in str(fault) for fault in stuck)
    refused(lambda: repair(path, out), InvalidUrdf, "cannot be mended", *words)
    assert not out.exists()


@pytest.mark.parametrize("name", model_names())
def test_packaged_robots_are_sound(name: str) -> None:
    report = inspect(name)
    assert report.loads
    assert report.faults == ()
    assert all(link.verdict in ("valid", "frame") for link in report.links)
    assert all(joint.velocity for joint in report.joints if joint.type == "revolute")


def test_the_report_says_what_is_there(tmp_path: Path) -> None:
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


def test_meshes_still_count_from_the_right_folder(tmp_path: Path) -> None:
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
def test_numbers_that_can_be_told(text: str, value: str) -> None:
    assert mended_number(text) == value


@pytest.mark.parametrize(
    "text",
    ["", " ", "1 2", "half", "1/0", "1kg", "2**9", "nan", "1e999", "9" * 400, "(" * 90, "__import__('os')",
     "pi.real", "True", "1 if 1 else 2", "[1]", "\u0663", "1,000,5", "a\0b", "${x}", "1_0j"],
)  # fmt: skip
def test_numbers_that_cannot(text: str) -> None:
    assert mended_number(text) is None


def command(*arguments: str) -> int:
    parser = argparse.ArgumentParser()
    add_parser(parser.add_subparsers(dest="command"))
    return run(parser.parse_args(["inspect", *arguments]))


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert command("planar_3r") == 0
    shown = capsys.readouterr().out
    for word in ("planar_3r", "link_3", "0.0043", "joint_2", "loads as it is"):
        assert word in shown
    path, out = write(tmp_path, in_joint_2('velocity="0.40002946455710037" ', "")), tmp_path / "out.urdf"
    assert command(str(path)) == 1
    shown = capsys.readouterr().out
    for word in ("refuses", "joint_2", "--repair"):
        assert word in shown
    assert command(str(path), "--repair", str(out), "--rate", "0.2") == 0
    shown = capsys.readouterr().out
    assert "1 change:" in shown
    assert "velocity limit set to 0.2 rad/s" in shown
    assert ffsms.load(out).n == 3
    with pytest.raises(InvalidUrdf, match="cannot be mended"):
        command(str(write(tmp_path, PLANAR.replace("31.015", "-1"))), "--repair", str(out))
