"""Mount arms from example-robot-data, from MJCF files and from Pinocchio models on a satellite."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from link_sums import arm_file
from paper_sums import assert_near

import ffsms_pin as ffsms
from ffsms_pin.errors import (
    AmbiguousEndEffector,
    FfsmsError,
    InvalidUrdf,
    InvalidValue,
    UnsupportedJoint,
)

Refused = Callable[..., FfsmsError]

MJCF = """<mujoco model="two"><compiler angle="radian"/><worldbody><body name="foot">
<inertial pos="0 0 0.1" mass="2" diaginertia="0.1 0.1 0.1"/>
<body name="upper" pos="0 0 0.1"><joint name="shoulder" axis="0 0 1" range="-1 1"/>
<inertial pos="0 0 0.2" mass="1.5" diaginertia="0.03 0.02 0.01"/>
<body name="lower" pos="0 0 0.4"><joint name="elbow" axis="0 1 0" range="-2 2"/>
<inertial pos="0 0 0.2" mass="1" diaginertia="0.01 0.02 0.03"/><site name="tool" pos="0 0 0.4"/>
<site name="camera" pos="0.1 0 0.3"/></body></body></body></worldbody></mujoco>"""
URDF = """<robot name="two">
<link name="foot"><inertial><origin xyz="0 0 0.1"/><mass value="2"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="upper"><inertial><origin xyz="0 0 0.2"/><mass value="1.5"/>
<inertia ixx="0.03" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="lower"><inertial><origin xyz="0 0 0.2"/><mass value="1"/>
<inertia ixx="0.01" iyy="0.02" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="tool"/><link name="camera"/>
<joint name="shoulder" type="revolute"><parent link="foot"/><child link="upper"/><origin xyz="0 0 0.1"/>
<axis xyz="0 0 1"/><limit lower="-1" upper="1" velocity="0.5" effort="1e13"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0 0 0.4"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="0.5" effort="1e13"/></joint>
<joint name="to_tool" type="fixed"><parent link="lower"/><child link="tool"/><origin xyz="0 0 0.4"/></joint>
<joint name="to_camera" type="fixed"><parent link="lower"/><child link="camera"/>
<origin xyz="0.1 0 0.3"/></joint></robot>"""


def assert_same(a: ffsms.SpaceManipulator, b: ffsms.SpaceManipulator) -> None:
    """Check that two robots have equal joint names, dynamics, tools, limits and base boxes."""
    assert a.joint_names == b.joint_names
    joints = np.linspace(-0.4, 0.7, a.n)
    base = pin.SE3(pin.rpy.rpyToMatrix(0.1, -0.2, 0.3), np.array([0.1, 0.2, 0.3]))
    x, y = (sms.at(sms.configuration(joints, base), np.linspace(-0.2, 0.3, 6 + sms.n)) for sms in (a, b))
    for name in ("H", "C_b", "C_m", "J_m", "J_star", "C_bm"):
        assert_near(name, getattr(x, name), getattr(y, name))
    assert_near("pose", x.end_effector_pose.homogeneous, y.end_effector_pose.homogeneous)
    for name in ("lower", "upper", "velocity", "acceleration", "torque"):
        np.testing.assert_allclose(getattr(a.limits, name), getattr(b.limits, name), rtol=1e-12)
    assert a.base_size == b.base_size
    assert a.base_box_placement.isApprox(b.base_box_placement)


@pytest.mark.parametrize("locked", [{}, {"joint4": 0.7}])
def test_a_model_equals_its_urdf(locked: dict[str, float]) -> None:
    base = ffsms.SatelliteBase(300.0, (1.2, 1.0, 0.8), com=(0.1, 0.0, -0.05))
    place = pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.2, -0.5), np.array([0.6, 0.1, 0.2]))
    model = pin.buildModelFromUrdf(str(arm_file("xarm7")))
    assert_same(
        ffsms.mount(model, base, place, locked=locked, velocity=0.4),
        ffsms.mount("xarm7", base, place, locked=locked, velocity=0.4),
    )


def test_a_continuous_joint_of_a_model_can_be_locked() -> None:
    model = pin.buildModelFromUrdf(str(arm_file("kinova")))
    angle = {"j2s6s200_joint_1": 2.1}
    assert_same(
        ffsms.mount(model, end_effector="j2s6s200_end_effector", locked=angle),
        ffsms.mount("kinova", locked=angle),
    )


@pytest.mark.parametrize("name", ["two.xml", "two.mjcf"])
def test_an_mjcf_file_equals_its_urdf(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(MJCF)
    (tmp_path / "two.urdf").write_text(URDF)
    from_mjcf, from_urdf = ffsms.mount(tmp_path / name), ffsms.mount(tmp_path / "two.urdf")
    assert from_mjcf.end_effector == from_urdf.end_effector == "tool"
    assert_same(from_mjcf, from_urdf)
    assert from_mjcf.model.gravity.linear[2] == 0.0
    assert ffsms.mount(tmp_path / name, torque=5.0).limits.torque.tolist() == [5.0, 5.0]


def test_a_urdf_may_be_called_xml(tmp_path: Path) -> None:
    (tmp_path / "two.xml").write_text(URDF)
    assert ffsms.mount(tmp_path / "two.xml").joint_names == ["shoulder", "elbow"]


@pytest.mark.parametrize(
    ("names", "tool"),
    [
        (("tool", "camera"), "tool"),
        (("tool0", "ee_link"), "tool0"),  # as in the files of Universal Robots
        (("camera", "wrist_ee"), "wrist_ee"),
        (("gripper_hand", "camera"), "gripper_hand"),
        (("hand_tcp", "left_hand"), "hand_tcp"),
        (("EndEffector_frame", "camera"), "EndEffector_frame"),
        (("tool0", "tool1"), None),
        (("end_effector_ball", "contact_point"), None),
        (("committee", "shorthand"), None),
    ],
)
def test_the_end_effector_is_chosen_by_its_name(
    refused: Refused, names: tuple[str, str], tool: str | None, tmp_path: Path
) -> None:
    path = tmp_path / "two.urdf"
    text = URDF.replace('"camera"', '"second"').replace('"tool"', f'"{names[0]}"')
    path.write_text(text.replace('"second"', f'"{names[1]}"'))
    if tool is None:
        for arm in (path, pin.buildModelFromUrdf(str(path))):
            sms = ffsms.mount(arm)
            refused(lambda sms=sms: sms.end_effector, AmbiguousEndEffector, *names)
            assert sorted(sms.end_effectors) == sorted(names)
    else:
        assert ffsms.mount(path).end_effector == tool
        assert ffsms.mount(pin.buildModelFromUrdf(str(path))).end_effector == tool


def test_two_arms_are_ambiguous_despite_a_tool_frame(refused: Refused, tmp_path: Path) -> None:
    second = (
        '<link name="hook"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"'
        ' iyz="0"/></inertial></link><joint name="other" type="continuous"><parent link="foot"/>'
        '<child link="hook"/><axis xyz="0 0 1"/></joint></robot>'
    )
    path = tmp_path / "two.urdf"
    path.write_text(URDF.replace("</robot>", second))
    sms = ffsms.mount(path)
    refused(lambda: sms.end_effector, AmbiguousEndEffector, "hook", "tool")


def test_any_loader_of_the_package() -> None:
    ur3, ur5 = ffsms.mount("ur3"), ffsms.mount("ur5_limited")
    assert (ur3.n, ur3.end_effector, ur5.end_effector) == (6, "tool0", "tool0")
    # The UR3 weighs 10.6 kg and the UR5 21 kg, 4 kg of them at its foot, so two different files are loaded.
    masses = [sum(body.mass for body in sms.model.inertias) - 200.0 for sms in (ur3, ur5)]
    assert 8.0 < masses[0] < 12.0 < 18.0 < masses[1] < 23.0
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Seven joints of the file move; the finger joints, which mimic one of them, are fixed.
        assert ffsms.mount("talos_arm", end_effector="gripper_left_base_link").n == 7
        assert ffsms.mount("panda_collision").joint_names == ffsms.mount("panda").joint_names


def test_bad_models(refused: Refused, tmp_path: Path) -> None:
    free = pin.buildModelFromUrdf(str(arm_file("xarm7")), pin.JointModelFreeFlyer())
    refused(lambda: ffsms.mount(free), UnsupportedJoint, "free-flyer", "root_joint")
    ball = pin.Model()
    ball.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "wrist")
    refused(lambda: ffsms.mount(ball), UnsupportedJoint, "wrist", "3 degrees")
    refused(lambda: ffsms.mount(pin.Model()), UnsupportedJoint, "no joint")
    path = tmp_path / "two.urdf"
    path.write_text(URDF)
    model = pin.buildModelFromUrdf(str(path))
    refused(lambda: ffsms.mount(model, locked={"wrist": 0.0}), InvalidValue, "wrist", "shoulder, elbow")
    refused(lambda: ffsms.mount(model, locked={"elbow": np.nan}), InvalidValue, "locked['elbow']")
    both = {"elbow": 0.0, "shoulder": 0.0}
    refused(lambda: ffsms.mount(model, locked=both), UnsupportedJoint, "locked")
    refused(lambda: ffsms.mount(model, velocity=[1.0]), InvalidValue, "velocity")
    bad = tmp_path / "bad.mjcf"
    bad.write_text("<mujoco><worldbody><body>")
    refused(lambda: ffsms.mount(bad), InvalidUrdf, "MJCF")
