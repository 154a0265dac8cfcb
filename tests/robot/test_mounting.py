"""Test arms on satellites: placement, locked joints and refused arguments."""

from __future__ import annotations

import copy
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from paper_sums import assert_near

import ffsms_pin as ffsms
from ffsms_pin.errors import (
    DependencyMissing,
    FfsmsError,
    FrameNotFound,
    InvalidUrdf,
    InvalidValue,
    ModelNotFound,
)
from ffsms_pin.urdf import model_path

Refused = Callable[..., FfsmsError]


def test_the_default_mount_points_along_x() -> None:
    sms = ffsms.mount("planar_3r", ffsms.SatelliteBase(100.0, (2.0, 1.0, 1.0)))
    state = sms.at(sms.configuration(np.zeros(3), pin.SE3.Identity()))
    data = sms.model.createData()
    pin.framesForwardKinematics(sms.model, data, state.q)
    foot = data.oMf[sms.model.getFrameId("base")]
    np.testing.assert_allclose(foot.translation, [1.0, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(foot.rotation[:, 2], [1.0, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(foot.rotation[:, 1], [0.0, 1.0, 0.0], atol=1e-15)
    assert sms.model.inertias[1].mass == pytest.approx(131.015)  # including the planar robot's own base


def test_a_locked_joint_is_fixed_at_its_position() -> None:
    free = ffsms.mount("xarm7")
    angle = 0.7
    held = ffsms.mount("xarm7", locked={"joint4": angle})
    joints = np.array([0.1, -0.2, 0.3, angle, 0.5, -0.6, 0.7])
    a = free.at(free.configuration(joints, pin.SE3.Identity()))
    b = held.at(held.configuration(np.delete(joints, 3), pin.SE3.Identity()))
    keep = [0, 1, 2, 4, 5, 6]
    assert_near("H_m", b.H_m, a.H_m[np.ix_(keep, keep)])
    assert_near("J_m", b.J_m, a.J_m[:, keep])
    assert_near("pose", b.end_effector_pose.homogeneous, a.end_effector_pose.homogeneous)
    slide = ffsms.mount("panda", locked={"panda_finger_joint1": 0.03})
    data = slide.model.createData()
    pin.framesForwardKinematics(slide.model, data, slide.configuration(np.zeros(7)))
    hand, finger = (data.oMf[slide.model.getFrameId(f"panda_{part}")] for part in ("hand", "leftfinger"))
    np.testing.assert_allclose(hand.actInv(finger).translation, [0.0, 0.03, 0.0584], atol=1e-15)


def test_an_arm_with_a_link_named_satellite_is_mounted() -> None:
    sms = ffsms.mount("space_arm_7")  # its base link is also named "satellite"
    assert sms.n == 7
    assert sms.model.inertias[1].mass == pytest.approx(2750.0)


@pytest.mark.parametrize(
    ("options", "fragment"),
    [
        ({"base": "cube"}, "base must be a SatelliteBase"),
        ({"placement": np.eye(3)}, "placement must be a pinocchio.SE3"),
        ({"placement": pin.SE3(2.0 * np.eye(3), np.zeros(3))}, "rotation"),
        ({"locked": {"joint9": 0.0}}, "joint9"),
        ({"locked": {"joint4": np.nan}}, "locked['joint4'] must be finite"),
        ({"locked": 3}, "locked must map"),
        ({"velocity": [1.0, 2.0]}, "velocity must have shape"),
        ({"velocity": 0.0}, "limits.velocity must be above zero"),
        ({"package_dirs": "here"}, "package_dirs"),
        ({"base_size": (1, 2)}, "base_size"),
    ],
)
def test_bad_mounts(refused: Refused, options: dict[str, Any], fragment: str) -> None:
    refused(lambda: ffsms.mount("xarm7", **options), InvalidValue, fragment)


@pytest.mark.parametrize(
    "values",
    [
        {"mass": 0.0},
        {"mass": "heavy"},
        {"size": (1.0, 1.0)},
        {"size": (1.0, 0.0, 1.0)},
        {"inertia": (1.0, 1.0, 3.0)},
        {"inertia": (1.0, 1.0, -1.0)},
        {"inertia": [[1.0, 0.1, 0.0], [0.2, 1.0, 0.0], [0.0, 0.0, 1.0]]},
        {"com": (0.0, np.inf, 0.0)},
        {"panels": (1.0, -1.0)},
    ],
)
def test_bad_satellites(refused: Refused, values: dict[str, Any]) -> None:
    refused(lambda: ffsms.SatelliteBase(**values), InvalidValue, next(iter(values)))


def test_bad_arms(refused: Refused, tmp_path: Path) -> None:
    refused(lambda: ffsms.mount("panda2"), ModelNotFound, "panda2", "xarm7")
    refused(lambda: ffsms.load("satellite_panda2"), ModelNotFound, "satellite_panda2", "satellite_xarm7")
    bad: Any = 3
    refused(lambda: ffsms.mount(bad), InvalidValue, "arm")
    refused(lambda: ffsms.mount("xarm7", end_effector="tool"), FrameNotFound, "tool")
    path = tmp_path / "loop.urdf"
    path.write_text(
        '<robot name="a"><link name="x"/><joint name="j" type="fixed">'
        '<parent link="x"/><child link="x"/></joint></robot>'
    )
    refused(lambda: ffsms.mount(path), InvalidUrdf, "root")
    for old, new in (('axis xyz="0 0 1"', 'axis xyz="0 0 0"'), ('xyz="0.3 0 0"', 'xyz="0.3 0"')):
        path.write_text(model_path("planar_3r").read_text().replace(old, new))
        refused(lambda: ffsms.mount(path, locked={"joint_2": 0.3}), InvalidUrdf, "joint_2", "locked")
    path.write_text("no robot")
    refused(lambda: ffsms.mount(path), InvalidUrdf, "XML")


def test_without_the_arms_package(refused: Refused, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in sys.modules if name.startswith("example_robot_data")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "example_robot_data", None)
    refused(lambda: ffsms.load("satellite_ur5"), DependencyMissing, "example-robot-data-loaders", "ur5")
    assert ffsms.load("space_arm_7").n == 7


def test_satellites_compare_by_value_and_copy_their_arrays() -> None:
    size = np.array([1.0, 2.0, 3.0])
    base = ffsms.SatelliteBase(size=size, inertia=np.diag([30.0, 20.0, 25.0]))
    size[0] = 9.0
    assert base == ffsms.SatelliteBase(200.0, (1, 2, 3), (30, 20, 25))
    assert hash(base) == hash(copy.copy(base))
    solid = ffsms.SatelliteBase(12.0, (1.0, 2.0, 3.0)).inertia_matrix
    np.testing.assert_array_equal(solid, np.diag([13.0, 10.0, 5.0]))
