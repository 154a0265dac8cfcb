"""Test that bad files and bad arguments of `load` cause a one-line error that names the cause."""

from __future__ import annotations

import builtins
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin.errors import (
    FfsmsError,
    FrameNotFound,
    InvalidInertia,
    InvalidUrdf,
    InvalidValue,
    ModelNotFound,
    UnsupportedJoint,
)
from ffsms_pin.urdf import model_path

Refused = Callable[..., FfsmsError]
PLANAR = model_path("planar_3r").read_text()
LINK_2 = PLANAR[PLANAR.index('<link name="link_2">') : PLANAR.index('<joint name="joint_3"')]
JOINT_2 = PLANAR[PLANAR.index('<joint name="joint_2"') : PLANAR.index('<link name="link_2">')]
BASE_INERTIAL = PLANAR[PLANAR.index("<inertial>") : PLANAR.index("</inertial>") + len("</inertial>")]
LIMIT_2 = JOINT_2[JOINT_2.index("<limit") : JOINT_2.index("</joint>")]


def in_link_2(old: str, new: str) -> str:
    assert old in LINK_2
    return PLANAR.replace(LINK_2, LINK_2.replace(old, new, 1))


def in_joint_2(old: str, new: str) -> str:
    assert old in JOINT_2
    return PLANAR.replace(JOINT_2, JOINT_2.replace(old, new, 1))


def adding(text: str) -> str:
    return PLANAR.replace("</robot>", text + "</robot>")


MASS, INERTIA = '<mass value="0.569"/>', 'ixx="0.0001" ixy="0" ixz="0" iyy="0.0043" iyz="0" izz="0.0043"'
FIXED = '<joint name="x" type="fixed"><parent link="{}"/><child link="{}"/></joint>'

BAD_FILES: dict[str, tuple[str, type[FfsmsError], tuple[str, ...]]] = {
    # not a robot description
    "text": ("a robot with three joints", InvalidUrdf, ("XML",)),
    "cut off": (PLANAR[:2000], InvalidUrdf, ("XML",)),
    "other XML": ("<html><body/></html>", InvalidUrdf, ("<html>",)),
    "no links": ('<robot name="a"/>', InvalidUrdf, ("no links",)),
    "unknown encoding": ('<?xml version="1.0" encoding="klingon"?><robot name="a"/>', InvalidUrdf, ("XML",)),
    # masses and inertias
    "no base inertial": (PLANAR.replace(BASE_INERTIAL, ""), InvalidInertia, ("base", "inertia")),
    "negative mass": (in_link_2(MASS, '<mass value="-0.569"/>'), InvalidInertia, ("link_2", "-0.569")),
    "indefinite inertia": (in_link_2('iyz="0"', 'iyz="0.01"'), InvalidInertia, ("link_2", "negative")),
    "triangle": (in_link_2('ixx="0.0001"', 'ixx="0.01"'), InvalidInertia, ("link_2", "triangle", "0.0043")),
    # numbers
    "NaN mass": (in_link_2(MASS, '<mass value="nan"/>'), InvalidUrdf, ("link_2", "nan")),
    "huge": (in_link_2(MASS, '<mass value="1e300"/>'), InvalidUrdf, ("link_2", "1e300", "beyond 1e+12")),
    "formula": (in_joint_2('upper="2.827433388230814"', 'upper="pi/2"'), InvalidUrdf, ("joint_2", "pi/2")),
    "unit": (in_link_2(MASS, '<mass value="0.569kg"/>'), InvalidUrdf, ("link_2", "0.569kg")),
    "other digits": (in_link_2(MASS, '<mass value="&#1635;"/>'), InvalidUrdf, ("link_2", "value")),
    "empty number": (in_link_2(MASS, '<mass value=""/>'), InvalidUrdf, ("link_2", "value")),
    "two numbers": (in_joint_2('xyz="0.3 0 0"', 'xyz="0.3 0"'), InvalidUrdf, ("joint_2", "0.3 0")),
    "flat box": (
        in_link_2('<box size="0.3 0.03 0.03"', '<box size="0.3 0 0.03"'),
        InvalidUrdf,
        ("link_2", "box"),
    ),
    # limits
    "a slide without limit": (
        in_joint_2(LIMIT_2, "").replace('"joint_2" type="revolute"', '"joint_2" type="prismatic"'),
        InvalidUrdf,
        ("joint_2", "prismatic", "<limit>"),
    ),
    "no velocity": (in_joint_2('velocity="0.40002946455710037" ', ""), InvalidUrdf, ("joint_2", "velocity")),
    "limits the wrong way round": (
        in_joint_2('lower="-2.827433388230814" upper="2.827433388230814"', 'lower="2" upper="-1"'),
        InvalidUrdf,
        ("joint_2", "wrong order", "2", "-1"),
    ),
    # joints and the tree
    "no joint": (
        f'<robot name="a"><link name="a">{BASE_INERTIAL}</link></robot>',
        UnsupportedJoint,
        ("no joint",),
    ),
    "floating joint": (in_joint_2('"revolute"', '"floating"'), UnsupportedJoint, ("joint_2", "floating")),
    "no type": (in_joint_2(' type="revolute"', ""), UnsupportedJoint, ("joint_2",)),
    "mimic of nothing": (
        in_joint_2("<limit", '<mimic joint="joint_9"/><limit'),
        UnsupportedJoint,
        ("joint_2", "mimic"),
    ),
    "mimic of itself": (
        in_joint_2("<limit", '<mimic joint="joint_2"/><limit'),
        UnsupportedJoint,
        ("joint_2", "mimic"),
    ),
    "unknown parent": (
        in_joint_2('parent link="link_1"', 'parent link="lin_1"'),
        InvalidUrdf,
        ("joint_2", "lin_1"),
    ),
    "two roots": (adding('<link name="debris"/>'), InvalidUrdf, ("base", "debris")),
    "two parents": (adding(FIXED.format("base", "link_3")), InvalidUrdf, ("link_3",)),
    "closed loop": (
        adding(
            '<link name="a"/><link name="b"/>'
            + FIXED.format("a", "b")
            + FIXED.format("b", "a").replace('"x"', '"y"')
        ),
        InvalidUrdf,
        ("loop", "a, b"),
    ),
    "no root": (adding(FIXED.format("link_3", "base")), InvalidUrdf, ("tree",)),
    "own parent": (adding('<link name="a"/>' + FIXED.format("a", "a")), InvalidUrdf, ("loop", "a")),
    "two links of one name": (adding('<link name="link_2"/>'), InvalidUrdf, ("two links", "link_2")),
    "two joints of one name": (
        adding('<link name="a"/>' + FIXED.format("base", "a").replace('"x"', '"joint_2"')),
        InvalidUrdf,
        ("two joints", "joint_2"),
    ),
    "joint without a name": (adding('<joint type="fixed"/>'), InvalidUrdf, ("joint", "name")),
    "line break in a name": (adding('<link name="a&#10;b"/>'), InvalidUrdf, ("a b",)),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_bad_file(refused: Refused, case: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    text, kind, fragments = BAD_FILES[case]
    path = tmp_path / "bad.urdf"
    path.write_text(text, encoding="utf-8")
    error = refused(lambda: ffsms.load(path), kind, *fragments)
    if isinstance(error, InvalidUrdf) and "positive definite" not in str(error):
        assert str(path) in str(error)
    assert capfd.readouterr().err == ""  # the C++ parser prints nothing


@pytest.mark.parametrize("robot", ["planar_4r", "", "no/such/file.urdf", "x" * 5000, "nul\0byte", Path(".")])
def test_no_such_model(refused: Refused, robot: Any) -> None:
    error = refused(lambda: ffsms.load(robot), ModelNotFound, "planar_3r")
    assert isinstance(error, FileNotFoundError)


def test_a_file_that_may_not_be_read(
    refused: Refused, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.urdf"
    path.write_text(PLANAR)

    def denied(*_: object, **__: object) -> bytes:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(builtins, "open", denied)
    refused(lambda: ffsms.load(path), InvalidUrdf, str(path), "Permission denied")


@pytest.mark.parametrize("robot", [None, 3, ["planar_3r"]])
def test_robot_of_a_wrong_type(refused: Refused, robot: Any) -> None:
    refused(lambda: ffsms.load(robot), InvalidValue, "robot")


@pytest.mark.parametrize("name", ["tool0", "universe"])
def test_frame_that_is_not_there(refused: Refused, name: Any) -> None:
    error = refused(
        lambda: ffsms.load("planar_3r", end_effector=name),
        FrameNotFound,
        f"'{name}'",
        "link_3",
        "end_effector",
    )
    assert isinstance(error, FrameNotFound)
    assert isinstance(error, KeyError)
    assert {"base", "link_1", "link_2", "link_3", "joint_1", "end_effector"} <= set(error.available)


@pytest.mark.parametrize(
    "size",
    [(1, 2), (1, 2, 0), (1, 2, np.nan), "big"],
)
def test_bad_base_size(refused: Refused, size: Any) -> None:
    refused(lambda: ffsms.load("planar_3r", base_size=size), InvalidValue, "base_size")


@pytest.mark.parametrize(
    "acceleration",
    [0.0, np.nan, (1, 2), "fast"],
)
def test_bad_acceleration(refused: Refused, acceleration: Any) -> None:
    refused(lambda: ffsms.load("planar_3r", acceleration=acceleration), InvalidValue, "acceleration")


@pytest.mark.parametrize(
    ("options", "fragments"),
    [
        ({"velocity": 0.0}, "limits.velocity"),
        ({"velocity": (1, 2)}, "velocity"),
        ({"torque": -1.0}, "limits.torque"),
        ({"torque": "strong"}, "torque"),
        ({"locked": ["joint_1"]}, "locked must map"),
        ({"locked": {"joint_9": 0.0}}, "joint_9"),
        ({"locked": {"joint_1": np.inf}}, "locked['joint_1'] must be finite"),
        ({"inertias": "any"}, "inertias"),
    ],
)
def test_bad_options(refused: Refused, options: dict[str, Any], fragments: str) -> None:
    refused(lambda: ffsms.load("planar_3r", **options), InvalidValue, fragments)


def test_helical_joints_are_refused() -> None:
    model = pin.Model()
    root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    screw = model.addJoint(root, pin.JointModelHX(0.01), pin.SE3.Identity(), "screw")
    for joint in (root, screw):
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    with pytest.raises(UnsupportedJoint, match="joint 'screw' is helical; only revolute and prismatic"):
        ffsms.load(model)
