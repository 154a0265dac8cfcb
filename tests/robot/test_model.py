"""Test the packaged planar robot, options of `load`, and configurations."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin.errors import FrameNotFound, UnsupportedJoint
from ffsms_pin.urdf import model_names, model_path

Builder = Callable[..., Any]
DEG = np.pi / 180.0


def rewritten(path: Path, *changes: tuple[str, str]) -> Path:
    """Write the planar robot's file with some text replaced, and return its path."""
    text = model_path("planar_3r").read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text)
    return path


# -- the paper's system ----------------------------------------------------------------------------------


def test_masses_and_inertias_of_the_paper(planar: ffsms.SpaceManipulator) -> None:
    masses = [body.mass for body in planar.model.inertias][1:]
    assert masses == [31.015, 0.569, 0.569, 0.569]
    np.testing.assert_array_equal(planar.model.inertias[1].inertia, np.diag([1.1594, 1.1594, 1.1129]))
    for body in list(planar.model.inertias)[2:]:
        np.testing.assert_allclose(body.inertia, np.diag([0.0001, 0.0043, 0.0043]), atol=1e-17)
        np.testing.assert_array_equal(body.lever, [0.15, 0.0, 0.0])
    places = [place.translation for place in planar.model.jointPlacements][2:]
    np.testing.assert_array_equal(places, [[0.232, 0, 0], [0.3, 0, 0], [0.3, 0, 0]])


def test_limits_of_the_paper(planar: ffsms.SpaceManipulator) -> None:
    limits = planar.limits
    np.testing.assert_allclose(limits.upper, np.array([81, 162, 162]) * DEG, rtol=1e-15)
    np.testing.assert_array_equal(limits.lower, -limits.upper)
    np.testing.assert_allclose(limits.velocity, 22.92 * DEG, rtol=1e-15)
    np.testing.assert_allclose(limits.acceleration, 28.65 * DEG, rtol=1e-15)  # the default is the paper's
    np.testing.assert_array_equal(limits.torque, [3.5, 1.5, 1.5])
    for name in ("lower", "upper", "velocity", "acceleration", "torque"):
        assert not getattr(limits, name).flags.writeable


def test_names_and_sizes(planar: ffsms.SpaceManipulator) -> None:
    assert planar.n == 3
    assert (planar.nq, planar.nv) == (10, 9)
    assert planar.joint_names == ["joint_1", "joint_2", "joint_3"]
    assert planar.end_effector == "end_effector"  # the last link, since there is only one
    assert planar.base_size == (0.464, 0.464, 0.483)
    np.testing.assert_array_equal(planar.base_com, np.zeros(3))
    np.testing.assert_array_equal(planar.model.gravity.vector, np.zeros(6))
    assert "planar_3r" in model_names()


def test_shapes_are_boxes_of_the_papers_sizes() -> None:
    robot = ElementTree.parse(model_path("planar_3r")).getroot()
    for link in robot.findall("link")[:4]:
        for kind in ("visual", "collision"):
            box = link.find(f"{kind}/geometry/box")
            assert box is not None
            expected = "0.464 0.464 0.483" if link.attrib["name"] == "base" else "0.3 0.03 0.03"
            assert box.attrib["size"] == expected


def test_initial_values_of_the_paper(planar: ffsms.SpaceManipulator) -> None:
    q = planar.configuration([DEG, DEG, DEG])
    state = planar.at(q)
    np.testing.assert_array_equal(q[3:7], [0.0, 0.0, 0.0, 1.0])
    np.testing.assert_allclose(state.com, np.zeros(3), atol=1e-16)
    # The paper prints four digits.
    np.testing.assert_array_equal(np.round(state.base_pose.translation, 4), [-0.0356, -0.0006, 0.0])
    # Links at 1, 2 and 3 degrees from the base's axis, summed by hand.
    turns = np.exp(1j * DEG * np.array([1.0, 2.0, 3.0]))
    middle = 0.232 + 0.3 * np.concatenate([[0.0], np.cumsum(turns)[:2]]) + 0.15 * turns
    base = -0.569 * middle.sum() / (31.015 + 3 * 0.569)
    np.testing.assert_allclose(state.base_pose.translation, [base.real, base.imag, 0.0], atol=1e-15)
    tip = base + 0.232 + 0.3 * turns.sum()
    np.testing.assert_allclose(state.end_effector_pose.translation, [tip.real, tip.imag, 0.0], atol=1e-15)


# -- options of load and of the constructor --------------------------------------------------------------


def test_a_path_and_a_packaged_name_load_the_same_model(planar: ffsms.SpaceManipulator) -> None:
    for path in (model_path("planar_3r"), str(model_path("planar_3r"))):
        assert ffsms.load(path).model == planar.model


def test_loading_prints_nothing(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    # Pinocchio's parser would print warnings about shapes and colours that the dynamics do not need.
    ffsms.load(
        rewritten(
            tmp_path / "a.urdf",
            ('<material name="body"><color rgba="0.80 0.78 0.72 1"/></material>', '<material name="body"/>'),
            ('<box size="0.3 0.03 0.03"/>', "<mesh/>"),
        )
    )
    captured = capfd.readouterr()
    assert captured.out == ""
    assert captured.err == ""


def test_acceleration_option() -> None:
    np.testing.assert_array_equal(ffsms.load("planar_3r", acceleration=2.0).limits.acceleration, 2.0)
    acceleration = ffsms.load("planar_3r", acceleration=[1.0, 2.0, 3.0]).limits.acceleration
    np.testing.assert_array_equal(acceleration, [1.0, 2.0, 3.0])


def test_base_size_option(tmp_path: Path) -> None:
    assert ffsms.load("planar_3r", base_size=(1, 2, 3)).base_size == (1.0, 2.0, 3.0)
    box = '<geometry><box size="0.464 0.464 0.483"/></geometry>'
    no_box = rewritten(tmp_path / "a.urdf", (box, '<geometry><sphere radius="0.3"/></geometry>'))
    assert ffsms.load(no_box).base_size is None
    placed = rewritten(
        tmp_path / "b.urdf",
        (
            f"<collision>{box}",
            f'<collision><origin xyz="0.1 0 0" rpy="0 0 0.5"/>{box.replace("0.483", "0.4")}',
        ),
    )
    sms = ffsms.load(placed)  # the base box is the collision box
    assert sms.base_size == (0.464, 0.464, 0.4)
    np.testing.assert_array_equal(sms.base_box_placement.translation, [0.1, 0.0, 0.0])
    np.testing.assert_allclose(sms.base_box_placement.rotation, pin.rpy.rpyToMatrix(0, 0, 0.5), atol=1e-16)


def test_end_effector_option(planar: ffsms.SpaceManipulator) -> None:
    middle = ffsms.load("planar_3r", end_effector="link_2")
    q = middle.configuration([0.1, 0.2, 0.3])
    assert middle.at(q).J_m[:, 2].tolist() == [0.0] * 6  # the third joint lies beyond it
    assert not np.array_equal(middle.at(q).J_star, planar.at(q).J_star)


def test_a_link_and_a_joint_of_the_same_name(tmp_path: Path, planar: ffsms.SpaceManipulator) -> None:
    # Link and joint are both frames in Pinocchio; the end effector is the link.
    swapped = rewritten(tmp_path / "a.urdf", ('joint name="joint_2"', 'joint name="end_effector"'))
    sms, joints = ffsms.load(swapped), [0.4, -0.3, 0.9]
    expected = planar.at(planar.configuration(joints)).end_effector_pose
    assert sms.at(sms.configuration(joints)).end_effector_pose.isApprox(expected, 1e-15)


def test_without_limits(random_tree: Builder) -> None:
    sms = ffsms.SpaceManipulator(random_tree(1, 3).model(), "tip")
    assert (sms.limits.lower == -np.inf).all()
    for name in ("upper", "velocity", "acceleration", "torque"):
        assert (getattr(sms.limits, name) == np.inf).all()
    assert sms.base_size is None


def test_the_constructor_does_not_change_its_model(random_tree: Builder) -> None:
    model = random_tree(1, 3).model()
    before = model.copy()
    sms = ffsms.SpaceManipulator(model, "tip")
    assert model == before
    assert model.gravity.linear[2] < -9.0
    np.testing.assert_array_equal(sms.model.gravity.vector, np.zeros(6))


def test_joint_order_that_pinocchio_gets_wrong(random_tree: Builder) -> None:
    # Pinocchio's inertia matrix is wrong if a second branch begins before the first branch ends.
    tree = random_tree(1, 3, ("revolute",))
    bodies = [body._replace(parent=p) for body, p in zip(tree.bodies, (-1, 0, 0, 1), strict=True)]
    with pytest.raises(UnsupportedJoint, match="joint_3"):
        ffsms.SpaceManipulator(type(tree)(bodies, tree.tip_rotation, tree.tip_position).model(), "tip")


def test_models_that_do_not_float(random_tree: Builder) -> None:
    joint = pin.JointModelRX()
    fixed = pin.Model()
    fixed.addJoint(0, joint, pin.SE3.Identity(), "joint_1")
    with pytest.raises(UnsupportedJoint, match="free-flyer"):
        ffsms.SpaceManipulator(fixed, "joint_1")
    with_second_root = random_tree(1, 2).model()
    with_second_root.addJoint(0, joint, pin.SE3.Identity(), "other")
    with pytest.raises(UnsupportedJoint, match="other"):
        ffsms.SpaceManipulator(with_second_root, "tip")
    with pytest.raises(FrameNotFound):
        ffsms.SpaceManipulator(random_tree(1, 2).model(), "universe")  # it does not move with the robot


# -- bodies made of several links -------------------------------------------------------------------------


def test_fixed_links_are_one_body(random_tree: Builder, tmp_path: Path) -> None:
    # A base of three fixed links, one of them without mass, has the same dynamics to 1e-12 as one body.
    tree = random_tree(8, 5, ("revolute", "prismatic"))
    mast = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.4, 0.5), np.array([0.2, 0.1, -0.3]))
    mast_body = pin.Inertia(7.0, np.array([0.1, 0.0, 0.2]), np.diag([0.4, 0.5, 0.6]))
    extra = (
        '<link name="adapter"/>'
        '<joint name="a" type="fixed"><parent link="link_0"/><child link="adapter"/></joint>'
        '<link name="mast"><inertial><origin xyz="0.1 0 0.2"/><mass value="7"/>'
        '<inertia ixx="0.4" ixy="0" ixz="0" iyy="0.5" iyz="0" izz="0.6"/></inertial></link>'
        '<joint name="m" type="fixed"><parent link="adapter"/><child link="mast"/>'
        '<origin xyz="0.2 0.1 -0.3" rpy="0.3 -0.4 0.5"/></joint>'
    )
    path = tmp_path / "parts.urdf"
    path.write_text(tree.urdf(extra))
    sms = ffsms.load(path, end_effector="tip")
    # Masses add; inertias are shifted to the common centre of mass by the parallel axis theorem.
    base = tree.bodies[0]
    parts = [
        (base.mass, base.com, base.inertia),
        (7.0, mast.act(mast_body.lever), mast.rotation @ mast_body.inertia @ mast.rotation.T),
    ]
    mass = sum(m for m, _, _ in parts)
    com = sum(m * c for m, c, _ in parts) / mass
    inertia = np.zeros((3, 3))
    for m, c, tensor in parts:
        d = c - com
        inertia += tensor + m * (d @ d * np.eye(3) - np.outer(d, d))
    whole = [base._replace(mass=mass, com=com, inertia=inertia), *tree.bodies[1:]]
    merged = ffsms.SpaceManipulator(type(tree)(whole, tree.tip_rotation, tree.tip_position).model(), "tip")
    np.testing.assert_allclose(sms.base_com, com, rtol=0.0, atol=1e-15)
    rng = np.random.default_rng(0)
    q = merged.configuration(rng.uniform(-1, 1, size=5), pin.SE3(mast.rotation, np.array([1.0, 2.0, 3.0])))
    v = rng.uniform(-1, 1, size=11)
    for name in ("H", "H_q", "C_bm", "J_star", "C_b", "C_m", "C_q", "base_twist", "momentum"):
        computed, expected = getattr(sms.at(q, v), name), getattr(merged.at(q, v), name)
        np.testing.assert_allclose(
            computed, expected, rtol=0.0, atol=1e-12 * max(1.0, np.abs(expected).max())
        )


# -- configurations, velocities, copies -------------------------------------------------------------------


def test_configuration_with_a_given_base(planar: ffsms.SpaceManipulator) -> None:
    base = pin.SE3(pin.rpy.rpyToMatrix(0.1, 0.2, 0.3), np.array([1.0, -2.0, 3.0]))
    q = planar.configuration([0.1, 0.2, 0.3], base)
    np.testing.assert_array_equal(q[7:], [0.1, 0.2, 0.3])
    assert planar.at(q).base_pose.isApprox(base, 1e-15)
    np.testing.assert_array_equal(planar.joint_positions(q), [0.1, 0.2, 0.3])


def test_default_configuration_has_the_centre_of_mass_at_the_origin(random_tree: Builder) -> None:
    for seed in range(5):
        sms = ffsms.SpaceManipulator(random_tree(seed, 4).model(), "tip")
        state = sms.at(sms.configuration([0.3, -1.0, 2.0, 0.4]))
        np.testing.assert_allclose(state.com, np.zeros(3), atol=1e-15)
        np.testing.assert_array_equal(state.base_pose.rotation, np.eye(3))


def test_continuous_joints_have_two_entries_of_q(random_tree: Builder, tmp_path: Path) -> None:
    tree = random_tree(0, 3, ("continuous",))
    bodies = [body._replace(kind="revolute" if i == 2 else body.kind) for i, body in enumerate(tree.bodies)]
    path = tmp_path / "a.urdf"
    path.write_text(type(tree)(bodies, tree.tip_rotation, tree.tip_position).urdf())
    sms = ffsms.load(path, end_effector="tip")
    assert (sms.n, sms.nq, sms.nv) == (3, 12, 9)
    joints = np.array([3.0, -1.2, -2.5])
    q = sms.configuration(joints)
    cos, sin = np.cos(joints), np.sin(joints)
    np.testing.assert_array_equal(q[7:], [cos[0], sin[0], joints[1], cos[2], sin[2]])
    np.testing.assert_allclose(sms.joint_positions(q), joints, atol=1e-15)
    np.testing.assert_allclose(
        sms.joint_positions(sms.configuration(joints + 2 * np.pi * np.array([1, 0, -2]))), joints
    )
    # Continuous joints have no position limits, even if the file has; rates and torques are limited.
    np.testing.assert_array_equal(sms.limits.lower, [-np.inf, -2.5, -np.inf])
    np.testing.assert_array_equal(sms.limits.upper, [np.inf, 2.0, np.inf])
    np.testing.assert_array_equal(sms.limits.velocity, 0.4)
    np.testing.assert_array_equal(sms.limits.torque, 3.0)
    # A configuration integrated by Pinocchio has the right joint positions.
    moved = pin.integrate(sms.model, q, 0.1 * sms.velocity(q, [1.0, 2.0, 3.0]))
    np.testing.assert_allclose(sms.joint_positions(moved), joints + np.array([0.1, 0.2, 0.3]), atol=1e-14)


def test_velocity_of_joints_at_rest(planar: ffsms.SpaceManipulator) -> None:
    q = planar.configuration([0.3, 0.2, 0.1])
    np.testing.assert_array_equal(planar.velocity(q, np.zeros(3)), np.zeros(9))


@pytest.mark.parametrize("copy_of", [copy.copy, copy.deepcopy, lambda sms: pickle.loads(pickle.dumps(sms))])
def test_copies_of_a_robot_are_equal(planar: ffsms.SpaceManipulator, copy_of: Callable[[Any], Any]) -> None:
    again = copy_of(planar)
    assert again.model == planar.model
    assert (again.n, again.joint_names, again.end_effector) == (3, planar.joint_names, "end_effector")
    assert again.base_size == planar.base_size
    q, v = planar.configuration([0.3, 0.2, 0.1]), np.linspace(-1, 1, 9)
    for name in ("H", "C_q", "J_star", "C_bm"):
        np.testing.assert_array_equal(getattr(again.at(q, v), name), getattr(planar.at(q, v), name))
    for name in ("lower", "upper", "velocity", "acceleration", "torque"):
        np.testing.assert_array_equal(getattr(again.limits, name), getattr(planar.limits, name))
        assert not getattr(again.limits, name).flags.writeable
    assert not again.base_com.flags.writeable


def test_a_joint_may_have_the_usual_name_of_the_root(tmp_path: Path) -> None:
    text = model_path("planar_3r").read_text(encoding="utf-8").replace("joint_1", "root_joint")
    path = tmp_path / "named.urdf"
    path.write_text(text, encoding="utf-8")
    named, planar = ffsms.load(path), ffsms.load("planar_3r")
    assert named.joint_names == ["root_joint", "joint_2", "joint_3"]
    q = planar.configuration([0.3, -0.4, 0.5])
    np.testing.assert_array_equal(named.at(q).H, planar.at(q).H)
