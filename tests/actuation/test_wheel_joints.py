"""Wheels declared in a URDF: not joints of the arm, but part of the base's mass."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin.errors import FfsmsError, FfsmsWarning, InvalidUrdf, InvalidValue, UnsupportedJoint
from ffsms_pin.inspection import repair
from ffsms_pin.urdf import model_path

Refused = Callable[..., FfsmsError]


def wheel(name: str, parent: str = "base_link", **changes: str) -> str:
    """Return the URDF of a wheel of 1 kg, spin inertia 0.002 about its z axis, which is x of its parent."""
    attributes = {
        "inertia": 'ixx="0.0011" iyy="0.0011" izz="0.002" ixy="0" ixz="0" iyz="0"',
        "com": "0 0 0.01",
        "axis": "0 0 1",
        "type": "continuous",
        **changes,
    }
    return f"""
    <link name="{name}"><inertial><origin xyz="{attributes["com"]}"/><mass value="1.0"/>
      <inertia {attributes["inertia"]}/></inertial></link>
    <joint name="spin_{name}" type="{attributes["type"]}"><parent link="{parent}"/><child link="{name}"/>
      <origin xyz="0.1 0.05 0" rpy="0 1.5707963267948966 0"/><axis xyz="{attributes["axis"]}"/>
      <limit lower="-1" upper="1" velocity="600" effort="0.1"/>
      <dynamics damping="1e-5" friction="1e-4"/></joint>"""


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    def write_urdf(*wheels: str) -> Path:
        text = model_path("planar_3r").read_text(encoding="utf-8")
        root = ffsms.load("planar_3r").model.frames[2].name
        path = tmp_path / "wheeled.urdf"
        added = "".join(wheels).replace("base_link", root)
        path.write_text(text.replace("</robot>", added + "</robot>"), encoding="utf-8")
        return path

    return write_urdf


def test_marked_joints_are_wheels_and_no_joints(
    write: Callable[..., Path], planar: ffsms.SpaceManipulator
) -> None:
    path = write(wheel("one"), wheel("two", axis="0 0 -2"))
    both = ffsms.load(path, end_effector=planar.end_effector)
    assert both.n == 5  # not marked, they are joints
    sms = ffsms.load(path, end_effector=planar.end_effector, wheels=["spin_one", "spin_two"])
    assert sms.joint_names == planar.joint_names
    wheels = sms.wheels
    assert wheels is not None
    np.testing.assert_allclose(wheels.axes, [[1, 0, 0], [-1, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(wheels.inertia, 0.002)
    np.testing.assert_allclose(wheels.torque, 0.1)
    np.testing.assert_allclose(wheels.momentum, 1.2)
    np.testing.assert_allclose(wheels.friction, 1e-5)
    np.testing.assert_allclose(wheels.coulomb, 1e-4)
    assert wheels.names == ("spin_one", "spin_two")
    assert sms.model.inertias[1].mass == pytest.approx(planar.model.inertias[1].mass + 2.0)
    # The same motion as with the wheels as joints of Pinocchio's model.
    q, v = sms.configuration([0.1, 0.4, -0.2]), np.linspace(-0.3, 0.4, 9)
    speeds, h = np.array([200.0, -120.0]), 0.002 * np.array([200.0, -120.0])
    model = both.model
    order = [both.joint_names.index(name) for name in (*planar.joint_names, "spin_one", "spin_two")]
    whole = np.zeros(11)
    whole[:6], whole[6 + np.array(order)] = v[:6], np.concatenate([v[6:], speeds])
    positions = np.zeros(5)
    positions[order[:3]] = q[7:]
    at = both.configuration(positions, pin.XYZQUATToSE3(q[:7]))
    momentum = pin.computeCentroidalMomentum(model, model.createData(), at, whole).vector
    expected = sms.at(q, v).momentum
    expected = np.concatenate([expected[:3], expected[3:] + wheels.total(h)])
    np.testing.assert_allclose(momentum, expected, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "fragments"),
    [
        (wheel("one", type="prismatic"), ["'spin_one' is prismatic", "revolute or continuous"]),
        (wheel("one", com="0.001 0.02 0"), ["not balanced", "0.02 m off its axis"]),
        (wheel("one", axis="1 0 0"), ["not symmetric"]),
        (wheel("one", parent="link_1"), ["'spin_one' is not on the base"]),
        (wheel("one") + wheel("two", parent="one"), ["carries another joint"]),
    ],
)
def test_unsuitable_joints_are_refused_as_wheels(
    write: Callable[..., Path], refused: Refused, text: str, fragments: list[str]
) -> None:
    path = write(text)
    refused(lambda: ffsms.load(path, wheels=["spin_one"]), UnsupportedJoint, str(path), *fragments)


@pytest.mark.parametrize("kind", ["revolute", "continuous"])
def test_revolute_and_continuous_joints_declare_the_same_wheel(write: Callable[..., Path], kind: str) -> None:
    """A revolute joint from 0 to 0 is the same wheel as a continuous joint; limits of zero mean no limits."""
    text = wheel("one", type=kind).replace('lower="-1" upper="1"', 'lower="0" upper="0"')
    usual = ffsms.load(write(wheel("one")), wheels=["spin_one"])
    declared = ffsms.load(write(text), wheels=["spin_one"])
    assert declared.joint_names == usual.joint_names
    assert declared.wheels is not None
    assert usual.wheels is not None
    for name in ("axes", "inertia", "torque", "momentum", "friction", "coulomb"):
        np.testing.assert_array_equal(getattr(declared.wheels, name), getattr(usual.wheels, name))
    without = write(text.replace('velocity="600" effort="0.1"', 'velocity="0" effort="0"'))
    with pytest.warns(FfsmsWarning, match="'spin_one'") as caught:
        declared = ffsms.load(without, wheels=["spin_one"])
    for limit, warning in zip(("rate limit", "torque limit"), caught, strict=True):
        assert limit in str(warning.message)
    assert declared.wheels is not None
    assert np.isinf([*declared.wheels.momentum, *declared.wheels.torque]).all()


def test_the_message_for_an_unnamed_wheel_names_the_argument(
    write: Callable[..., Path], refused: Refused
) -> None:
    path = write(wheel("one", type="revolute").replace('lower="-1" upper="1"', 'lower="0" upper="0"'))
    refused(lambda: ffsms.load(path), InvalidUrdf, "'spin_one'", "limits of 0", "wheels=['spin_one']")


def test_a_repair_never_fixes_a_wheel_to_the_base(write: Callable[..., Path], tmp_path: Path) -> None:
    text = wheel("one", type="revolute").replace('lower="-1" upper="1"', 'lower="0" upper="0"')
    path = write(text.replace('velocity="600"', 'velocity="0"'))
    changes = repair(path, tmp_path / "repaired.urdf")
    assert {change.remedy for change in changes} == {
        "made continuous, because the joint turns a wheel",
        "velocity limit removed, because the joint turns a wheel",
    }
    sms = ffsms.load(tmp_path / "repaired.urdf", wheels=["spin_one"])
    assert sms.joint_names == ["joint_1", "joint_2", "joint_3"]
    # A body that is not balanced is fixed.
    repair(write(text.replace('xyz="0 0 0.01"', 'xyz="0.05 0 0.01"')), tmp_path / "fixed.urdf")
    assert ffsms.load(tmp_path / "fixed.urdf").joint_names == ["joint_1", "joint_2", "joint_3"]


def test_invalid_names_of_wheels_are_refused(write: Callable[..., Path], refused: Refused) -> None:
    path = write(wheel("one"))
    refused(lambda: ffsms.load(path, wheels=["spin_two"]), InvalidValue, "wheels", "spin_one")
    refused(lambda: ffsms.load(path, wheels="spin_one"), InvalidValue, "wheels", "list of names")
    refused(lambda: ffsms.load("satellite_panda", wheels=["a"]), InvalidValue, "with_actuators")


def test_mount_accepts_wheels_and_thrusters(refused: Refused) -> None:
    wheels = ffsms.ReactionWheels(np.eye(3), 0.02)
    thrusters = ffsms.Thrusters([0, 0, 0], [1, 0, 0], 1.0, proportional=True)
    sms = ffsms.mount("panda", wheels=wheels, thrusters=thrusters)
    assert sms.wheels is wheels
    assert sms.thrusters is thrusters
    assert sms.n == 7
    refused(lambda: ffsms.mount("panda", wheels=["a"]), InvalidValue, "wheels", "ReactionWheels")  # type: ignore[arg-type]
