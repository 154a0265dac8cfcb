"""Test that `inspect` finds faults of damaged files, and that `repair` corrects and lists them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from broken_urdfs import BOUNDS, LIMIT_2, PLANAR, in_joint_2, in_link_2, limits, write

import ffsms_pin as ffsms
from ffsms_pin.errors import FfsmsError, FfsmsWarning, InvalidUrdf
from ffsms_pin.inspection import inspect, repair

Refused = Callable[..., FfsmsError]


def body(sms: ffsms.SpaceManipulator, joint: str) -> Any:
    return sms.model.inertias[sms.model.getJointId(joint)]


PI = np.pi
USUAL = [-2.827433388230814, 2.827433388230814, 0.40002946455710037, 1.5]
# The damaged text, the element and a word of its fault, and a check of the repaired robot.
REPAIRED: dict[str, tuple[str, str, str, Callable[[ffsms.SpaceManipulator], bool]]] = {
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
    "wrong order": (
        in_joint_2(BOUNDS, 'lower="2" upper="-1"'),
        "joint 'joint_2'",
        "wrong order",
        lambda sms: limits(sms)[:2] == [-1.0, 2.0],
    ),
    "limits are equal": (
        in_joint_2(BOUNDS, 'lower="0.3" upper="0.3"'),
        "joint 'joint_2'",
        "limits are equal",
        lambda sms: sms.joint_names == ["joint_1", "joint_3"],
    ),
    "mimic": (
        in_joint_2("<limit", '<mimic joint="joint_1" offset="0.2"/><limit'),
        "joint 'joint_2'",
        "mimics",
        lambda sms: sms.joint_names == ["joint_1", "joint_3"],
    ),
    "mimic with a formula": (
        in_joint_2("<limit", '<mimic joint="joint_1" offset="pi/2"/><limit'),
        "joint 'joint_2'",
        "pi/2",
        lambda sms: sms.joint_names == ["joint_1", "joint_3"],
    ),
    "mimic in a loop": (
        in_joint_2("<limit", '<mimic joint="joint_3"/><limit').replace(
            'name="joint_3" type="revolute">', 'name="joint_3" type="revolute"><mimic joint="joint_2"/>'
        ),
        "joint 'joint_2'",
        "mimics",
        lambda sms: sms.joint_names == ["joint_1"],
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
        # The second moments are (-0.0007, 0.005, 0.005); repair sets the negative value to zero.
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
        # Repair assumes a sphere of aluminium; 0.569 kg have 2.107e-4 m^3 and a radius of 36.9 mm.
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


@pytest.mark.parametrize("case", REPAIRED)
def test_faults_are_found_and_repaired(case: str, tmp_path: Path) -> None:
    text, where, fragment, is_repaired = REPAIRED[case]
    path, out = write(tmp_path, text), tmp_path / "mended.urdf"
    lenient = case in LENIENT
    if lenient:
        with pytest.warns(FfsmsWarning, match=where.split()[1]):
            assert is_repaired(ffsms.load(path))
    else:
        with pytest.raises(FfsmsError):
            ffsms.load(path)
    report = inspect(path)
    assert report.loads is lenient
    assert bool(report.refusal) is not lenient
    assert report.repairable
    faults = [fault for fault in report.faults if fault.where == where and fragment in fault.problem]
    assert faults
    assert faults[0].blocks is not lenient
    assert faults[0].remedy
    assert path.read_text(encoding="utf-8") == text

    changes = repair(path, out)
    assert path.read_text(encoding="utf-8") == text
    assert {change.where for change in changes} >= {where}
    # Every change is also listed in the repaired file.
    mended = out.read_text(encoding="utf-8")
    for change in changes:
        assert str(change).replace("--", "- -").replace("<", "&lt;") in mended.replace("<", "&lt;")
    sms = ffsms.load(out)
    assert is_repaired(sms)
    again = inspect(out)
    assert again.loads
    assert not [fault for fault in again.faults if fault.blocks]
    assert repair(out, tmp_path / "again.urdf") == []


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
}


@pytest.mark.parametrize("case", STUCK)
def test_faults_that_cannot_be_repaired_are_reported(refused: Refused, case: str, tmp_path: Path) -> None:
    text, fragments = STUCK[case]
    path, out = write(tmp_path, text), tmp_path / "out.urdf"
    report = inspect(path)
    assert not report.loads
    assert not report.repairable
    stuck = [fault for fault in report.faults if fault.blocks and fault.remedy is None]
    assert stuck
    for word in fragments:
        assert any(word in str(fault) for fault in stuck)
    refused(lambda: repair(path, out), InvalidUrdf, "cannot be repaired", *fragments)
    assert not out.exists()


def test_a_name_with_dashes_leaves_the_written_file_readable(tmp_path: Path) -> None:
    """The comment with the changes must not contain two dashes in a row."""
    text = in_joint_2(BOUNDS, 'lower="2" upper="-1"').replace('name="joint_2"', 'name="joint---2"')
    repair(write(tmp_path, text), tmp_path / "out.urdf")
    assert ffsms.load(tmp_path / "out.urdf").joint_names[1] == "joint---2"
