"""Test exported robots: loaded again they are equal, and MuJoCo simulates them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import coal
import mujoco as mj
import numpy as np
import pinocchio as pin
import pytest
from engines import ROBOTS, Mujoco, ours, random_state, relative_differences, robot
from motions import random_pose

import ffsms_pin as ffsms
from ffsms_pin.cli import main
from ffsms_pin.errors import FfsmsWarning
from ffsms_pin.export import to_mjcf, to_urdf
from ffsms_pin.urdf import model_path


def written(sms: ffsms.SpaceManipulator, path: Path) -> ffsms.SpaceManipulator:
    to_urdf(sms, path)
    return ffsms.load(path, end_effector=sms.end_effector)


def assert_same(sms: ffsms.SpaceManipulator, again: ffsms.SpaceManipulator) -> None:
    """Check that names, matrices, limits, base box and shapes of two robots are equal to 1e-12."""
    assert again.joint_names == sms.joint_names
    q, v = random_state(sms, np.random.default_rng(3))
    assert max(relative_differences(ours(sms, q, v), ours(again, q, v)).values()) < 1e-12
    np.testing.assert_allclose(again.limits.table, sms.limits.table, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(again.limits.torque, sms.limits.torque, rtol=1e-12)
    assert again.base_size == sms.base_size
    np.testing.assert_allclose(again.base_box_placement, sms.base_box_placement, atol=1e-12)
    for kind in ("visual", "collision"):
        shapes, others = (robot.geometry(kind).geometryObjects for robot in (sms, again))
        assert [shape.name for shape in others] == [shape.name for shape in shapes]
        for original, loaded_shape in zip(shapes, others, strict=True):
            np.testing.assert_allclose(loaded_shape.placement, original.placement, atol=1e-12)
            np.testing.assert_allclose(loaded_shape.meshColor, original.meshColor, atol=1e-12)
            assert loaded_shape.geometry == original.geometry


@pytest.mark.parametrize(
    "name",
    [*ROBOTS, "servicer", pytest.param("satellite_kinova", marks=[pytest.mark.slow, pytest.mark.long])],
)
def test_a_written_urdf_is_the_same_robot(name: str, tmp_path: Path) -> None:
    sms = robot(name)
    again = written(sms, tmp_path / "robot.urdf")
    assert_same(sms, again)
    frames = {frame.name for frame in sms.model.frames if frame.type == pin.FrameType.BODY}
    assert frames <= {frame.name for frame in again.model.frames}


def test_an_exported_folder_with_meshes_can_be_moved(tmp_path: Path) -> None:
    sms = ffsms.mount("panda", ffsms.SatelliteBase(mass=80.0, panels=(2.0, 0.5)), velocity=0.1)
    (tmp_path / "one").mkdir()
    to_urdf(sms, tmp_path / "one" / "robot.urdf")
    (tmp_path / "one").rename(tmp_path / "other")
    assert_same(sms, ffsms.load(tmp_path / "other" / "robot.urdf", end_effector=sms.end_effector))


def test_changed_inertias_are_exported(tmp_path: Path) -> None:
    """Exported inertias are those of the robot, not those of the file from which it was loaded."""
    sms = ffsms.load("space_arm_7")
    heavier = [pin.Inertia(2.0 * body.mass, body.lever, 2.0 * body.inertia) for body in sms.model.inertias]
    changed = sms.with_inertias(heavier[1:])
    again = written(changed, tmp_path / "robot.urdf")
    assert_same(changed, again)
    assert np.abs(again.at(pin.neutral(sms.model)).H - sms.at(pin.neutral(sms.model)).H).max() > 1.0


def model_of_shapes() -> ffsms.SpaceManipulator:
    """Return a robot from a Pinocchio model, with a prismatic joint, a capsule and an ellipsoid."""
    model, shapes, rng = pin.Model(), pin.GeometryModel(), np.random.default_rng(1)
    joints = (pin.JointModelFreeFlyer(), pin.JointModelRY(), pin.JointModelPrismaticUnaligned(0.6, 0.0, 0.8))
    parent, place = 0, pin.SE3.Identity()
    for k, joint in enumerate(joints):
        parent = model.addJoint(parent, joint, place, f"joint {k} & <{k}>")
        model.addJointFrame(parent)
        model.appendBodyToJoint(parent, pin.Inertia.FromBox(3.0, 0.3, 0.4, 0.5), random_pose(rng))
        place = random_pose(rng)
    round_one, solid = coal.Capsule(0.1, 0.4), coal.Ellipsoid(0.1, 0.2, 0.3)
    for k, shape in enumerate((round_one, solid)):
        shapes.addGeometryObject(pin.GeometryObject(f"shape {k}", k + 1, random_pose(rng), shape))
    rates = np.array(model.upperVelocityLimit)
    rates[6:] = 0.3
    model.upperVelocityLimit = rates
    return ffsms.load(model, end_effector=model.names[3], collision=shapes)


def test_a_pinocchio_model_with_shapes_is_exported(tmp_path: Path) -> None:
    sms = model_of_shapes()
    again = written(sms, tmp_path / "robot.urdf")
    q, v = random_state(sms, np.random.default_rng(3))
    assert max(relative_differences(ours(sms, q, v), ours(again, q, v)).values()) < 1e-12
    np.testing.assert_array_equal(again.limits.upper, sms.limits.upper)
    assert len(again.convex_parts()) == 5  # the capsule as three parts, the ellipsoid as two slabs
    assert max(relative_differences(ours(sms, q, v), Mujoco(sms).matrices(q, v)).values()) < 1e-11
    sms.model.armature[6:] = 0.5
    with pytest.warns(FfsmsWarning, match="armature"):
        to_urdf(sms, tmp_path / "robot.urdf")


def loaded(sms: ffsms.SpaceManipulator, **options: Any) -> tuple[Any, Any]:
    model = mj.MjModel.from_xml_string(to_mjcf(sms, **options))
    return model, mj.MjData(model)


@pytest.mark.parametrize("name", [*ROBOTS, "servicer"])
def test_the_robot_in_mujoco_has_the_same_inertia_and_shapes(name: str) -> None:
    sms = robot(name)
    peer = Mujoco(sms, shapes=True)
    q, v = random_state(sms, np.random.default_rng(4))
    assert np.abs(peer.matrices(q, v).H - ours(sms, q, v).H).max() < 1e-12 * np.abs(ours(sms, q, v).H).max()
    groups = list(peer.model.geom_group)
    assert groups.count(2) == sms.geometry("visual").ngeoms
    assert groups.count(3) == sms.geometry("collision").ngeoms
    # MuJoCo's bodies are the links.
    bodies = [mj.mj_id2name(peer.model, mj.mjtObj.mjOBJ_BODY, k) for k in range(1, peer.model.nbody)]
    assert {frame.name for frame in sms.model.frames if frame.type == pin.FrameType.BODY} == {
        name.replace("world_", "world") for name in bodies
    }


def test_shapes_do_not_change_the_motion_and_meet_the_world() -> None:
    """The arm does not collide with its own base, but with a ball at its end effector."""
    sms = ffsms.load("planar_3r")
    ends = []
    for shapes in (False, True):
        model, data = loaded(sms, shapes=shapes)
        data.qpos[7:] = 2.9, 2.9, 2.9
        data.qvel[6:] = 0.1, -0.2, 0.1
        for _ in range(200):
            mj.mj_step(model, data)
            assert data.ncon == 0
        ends.append(np.concatenate([data.qpos, data.qvel]))
    np.testing.assert_array_equal(ends[0], ends[1])
    text = to_mjcf(sms).replace("<worldbody>", '<worldbody><geom size="0.2" pos="0.5 0 0"/>')
    model = mj.MjModel.from_xml_string(text)
    data = mj.MjData(model)
    mj.mj_forward(model, data)
    assert data.ncon > 0


def test_a_limit_stops_a_joint_and_without_it_the_joint_goes_on() -> None:
    sms = ffsms.load("planar_3r")
    upper = float(sms.limits.upper[1])
    text, ends = to_mjcf(sms), []
    for document in (text, text.replace('limited="true" range', 'limited="false" range')):
        model = mj.MjModel.from_xml_string(document)
        data = mj.MjData(model)
        data.qpos[8] = upper - 0.05
        data.ctrl[1] = 0.05
        highest = 0.0
        for _ in range(8000):
            mj.mj_step(model, data)
            highest = max(highest, float(data.qpos[8]))
        ends.append((highest, float(data.qpos[8])))
    (highest, end), (_, without) = ends
    assert upper - 1e-2 < end < upper + 1e-2
    assert highest < upper + 1e-2
    assert without > upper + 0.1


def test_motors_are_limited_to_their_torque() -> None:
    sms = ffsms.load("planar_3r")
    model, data = loaded(sms)
    data.ctrl[:] = 1e6
    mj.mj_forward(model, data)
    np.testing.assert_allclose(data.qfrc_actuator[6:], sms.limits.torque)


def test_a_missing_visual_mesh_is_left_out_with_a_warning(tmp_path: Path) -> None:
    path = tmp_path / "a.urdf"
    text = model_path("planar_3r").read_text()
    start = '<visual><origin xyz="0.15 0 0"/><geometry>'
    path.write_text(text.replace(start + '<box size="0.3 0.03 0.03"/>', start + '<mesh filename="a.stl"/>'))
    with pytest.warns(FfsmsWarning, match=r"missing: 'a\.stl'.*not drawn"):
        model, _ = loaded(ffsms.load(path))
    assert list(model.geom_group).count(3) == 4


def test_the_command_writes_both_and_mounted_satellites_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = tmp_path / "mine.toml"
    text = (Path(ffsms.__file__).parent / "scenarios" / "case-2.toml").read_text(encoding="utf-8")
    head, tail = text[: text.index("[robot]")], text[text.index("[robot]") :]
    rest = tail[tail.index("\n[", 1) :]
    mount = '[robot]\nmodel = "planar_3r"\n[robot.mount]\nmass = 80.0\nsize = [0.5, 0.5, 0.5]\n'
    scenario.write_text(head + mount + rest, encoding="utf-8")
    for model, mass in (("planar_3r", 31.0), (str(scenario), 80.0)):
        assert main(["export", model, "--urdf", str(tmp_path / "a.urdf")]) == 0
        again = ffsms.load(tmp_path / "a.urdf", end_effector="end_effector")
        assert again.model.inertias[1].mass >= mass
        assert main(["export", model, "--mjcf", str(tmp_path / "a.xml")]) == 0
        assert mj.MjModel.from_xml_path(str(tmp_path / "a.xml")).nv == 9
    assert "its end effector is 'end_effector'" in capsys.readouterr().out
    assert main(["export", "planar_3r"]) == 2
    for model in ("planar_3r", "satellite_xarm7"):
        assert main(["export", model, "--urdf", str(tmp_path / "none" / "a.urdf")]) == 2
