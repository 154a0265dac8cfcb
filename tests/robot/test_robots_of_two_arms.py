"""Test robots with several arms: loading, mounting, and the choice of the end effector."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin import export, opt
from ffsms_pin.errors import AmbiguousEndEffector, FfsmsError, FrameNotFound, InvalidValue, ModelNotFound
from ffsms_pin.robot.mounting import find_arm
from ffsms_pin.urdf import model_path

Refused = Callable[..., FfsmsError]


@pytest.fixture(scope="module")
def both() -> ffsms.SpaceManipulator:
    return ffsms.load("two_arms")


@pytest.fixture(scope="module")
def mixed() -> ffsms.SpaceManipulator:
    return ffsms.mount(["panda", "ur5"])


def test_two_arms_load_with_both_end_effectors(both: ffsms.SpaceManipulator) -> None:
    assert both.end_effectors == ["left_tool", "right_tool"]
    assert "none chosen of left_tool, right_tool" in repr(both)
    again = pickle.loads(pickle.dumps(both))
    assert again.end_effectors == both.end_effectors
    # Quantities that do not depend on the end effector are available.
    state = both.at(both.configuration([0.1] * 14))
    chosen = ffsms.load("two_arms", end_effector="left_tool").at(state.q)
    np.testing.assert_array_equal(state.H, chosen.H)
    np.testing.assert_array_equal(state.C_bm, chosen.C_bm)
    assert state.frame("right_tool").J_star.shape == (6, 14)


@pytest.mark.parametrize(
    "call",
    [
        lambda sms, q: sms.end_effector,
        lambda sms, q: sms.at(q).J_star,
        lambda sms, q: sms.at(q).end_effector_pose,
        lambda sms, q: opt.plan(sms, q, [1.0, 0.0, 0.0]),
        lambda sms, q: sms.home(),
    ],
)
def test_quantities_of_the_end_effector_require_a_choice(
    both: ffsms.SpaceManipulator, refused: Refused, call: Callable[[Any, Any], Any]
) -> None:
    q = both.configuration([0.1] * 14)
    fragments = ("left_tool", "right_tool", "load(..., end_effector=NAME)", "sms.with_end_effector(NAME)")
    refused(lambda: call(both, q), AmbiguousEndEffector, *fragments)


def test_an_end_effector_can_be_chosen_after_loading(both: ffsms.SpaceManipulator, refused: Refused) -> None:
    for name in both.end_effectors:
        chosen, loaded = both.with_end_effector(name), ffsms.load("two_arms", end_effector=name)
        q = both.configuration([0.1] * 14)
        np.testing.assert_array_equal(chosen.at(q).J_star, loaded.at(q).J_star)
        assert chosen.end_effectors == both.end_effectors
        assert chosen.base_size == both.base_size
    refused(lambda: both.with_end_effector("middle_tool"), FrameNotFound, "middle_tool")


def test_links_fixed_to_the_base_are_no_end_effectors(tmp_path: Path) -> None:
    panel = (
        '<link name="panel"/><joint name="p" type="fixed"><parent link="{}"/><child link="panel"/></joint>'
    )
    text = Path(model_path("planar_3r")).read_text("utf-8")
    for link in ("base", "link_1"):
        (tmp_path / "panel.urdf").write_text(text.replace("</robot>", panel.format(link) + "</robot>"))
        assert ffsms.load(tmp_path / "panel.urdf").end_effector == "end_effector"


def test_arms_are_mounted_side_by_side(mixed: ffsms.SpaceManipulator) -> None:
    """Each tool has the pose of a single arm at the same placement, and the masses add."""
    panda, ur5 = (ffsms.mount(name) for name in ("panda", "ur5"))
    assert mixed.joint_names == [*panda.joint_names, *ur5.joint_names]
    assert mixed.end_effectors == ["panda_hand_tcp", "tool0"]
    joints = np.linspace(-0.5, 0.7, 13) + np.array([0.0] * 3 + [-1.5] + [0.0] * 9)
    here = pin.SE3.Identity()
    state = mixed.at(mixed.configuration(joints, here))
    for alone, part, offset in ((panda, joints[:7], 0.25), (ur5, joints[7:], -0.25)):
        expected = alone.at(alone.configuration(part, here)).end_effector_pose
        expected.translation += np.array([0.0, offset, 0.0])
        assert state.frame(alone.end_effector).pose.isApprox(expected, 1e-12)
    masses = [sum(body.mass for body in sms.model.inertias) for sms in (mixed, panda, ur5)]
    assert masses[0] == pytest.approx(masses[1] + masses[2] - 200.0)
    shapes = [sms.geometry("collision").ngeoms for sms in (mixed, panda, ur5)]
    assert shapes[0] == shapes[1] + shapes[2] - 1  # one satellite


def test_names_of_two_equal_arms_get_prefixes(tmp_path: Path) -> None:
    placements = [pin.SE3(np.eye(3), np.array([0.0, y, 0.5])) for y in (0.3, -0.3)]
    sms = ffsms.mount(["z1", "z1"], placement=[placements[0], placements[1].homogeneous])
    alone = ffsms.mount("z1", placement=placements[1])
    assert sms.joint_names == [f"arm{i}_{name}" for i in (1, 2) for name in alone.joint_names]
    assert len(sms.end_effectors) == 2
    joints = np.linspace(-0.2, 0.6, 6)
    q = sms.configuration([*np.zeros(6), *joints], pin.SE3.Identity())
    expected = alone.at(alone.configuration(joints, pin.SE3.Identity()))
    assert sms.at(q).frame("arm2_gripperStator").pose.isApprox(expected.end_effector_pose, 1e-12)
    export.to_urdf(sms, tmp_path / "both.urdf")
    again = ffsms.load(tmp_path / "both.urdf")
    np.testing.assert_allclose(again.at(q).H_q, sms.at(q).H_q, rtol=0.0, atol=1e-12)


def test_a_model_mounted_beside_a_urdf_equals_its_urdf(mixed: ffsms.SpaceManipulator) -> None:
    sms = ffsms.mount(["panda", pin.buildModelFromUrdf(str(find_arm("ur5")[0]))])
    assert sms.joint_names == mixed.joint_names
    joints = np.linspace(-0.5, 0.7, 13) + np.array([0.0] * 3 + [-1.5] + [0.0] * 9)
    computed, expected = (robot.at(robot.configuration(joints)) for robot in (sms, mixed))
    np.testing.assert_allclose(computed.H, expected.H, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(computed.H_q, expected.H_q, rtol=0.0, atol=1e-12)
    assert computed.frame("tool0").pose.isApprox(expected.frame("tool0").pose, 1e-12)
    assert sms.base_size == mixed.base_size
    np.testing.assert_allclose(sms.limits.lower, mixed.limits.lower)
    assert sms.geometry("collision").ngeoms == ffsms.mount("panda").geometry("collision").ngeoms


def test_the_box_of_a_satellite_does_not_depend_on_its_centre_of_mass() -> None:
    model = pin.buildModelFromUrdf(str(find_arm("ur5")[0]))
    placed = [
        ffsms.mount(arms, ffsms.SatelliteBase(com=(0.1, 0.0, 0.0))).base_box_placement
        for arms in ("panda", ["panda", "ur5"], ["panda", model])
    ]
    for pose in placed:
        np.testing.assert_allclose(pose.translation, placed[0].translation, atol=1e-12)


def test_mjcf_files_are_mounted_beside_other_arms(tmp_path: Path) -> None:
    """Each tool has the pose of a single arm at the same placement, and the masses add."""
    path = tmp_path / "boom.xml"
    path.write_text(
        '<mujoco model="boom"><compiler angle="radian"/><worldbody><body name="l1" pos="0.3 0 0.1">'
        '<joint name="a" axis="0 1 0" armature="0.2" damping="0.5" frictionloss="0.1"/>'
        '<inertial pos="0.1 0 0.02" mass="2" diaginertia="0.01 0.03 0.03"/><geom size="0.1"/>'
        '<site name="boom_tip" pos="0.5 0 0"/></body></worldbody></mujoco>'
    )
    sms, boom, ur5 = ffsms.mount(["ur5", path]), ffsms.mount(path), ffsms.mount("ur5")
    assert sms.joint_names == [*ur5.joint_names, "a"]
    assert sms.model.armature[6:].tolist() == [0.0] * 6 + [0.2]
    assert (sms.joint_damping[-1], sms.joint_friction[-1]) == (0.5, 0.1)
    here, joints = pin.SE3.Identity(), np.linspace(-0.5, 0.7, 7)
    state = sms.at(sms.configuration(joints, here))
    for alone, part, frame, offset in (
        (ur5, joints[:6], "tool0", 0.25),
        (boom, joints[6:], "boom_tip", -0.25),
    ):
        expected = alone.at(alone.configuration(part, here)).frame(frame).pose
        expected.translation += np.array([0.0, offset, 0.0])
        assert state.frame(frame).pose.isApprox(expected, 1e-12)
    masses = [sum(body.mass for body in robot.model.inertias) for robot in (sms, boom, ur5)]
    assert masses[0] == pytest.approx(masses[1] + masses[2] - 200.0)
    shapes = [robot.geometry("collision").ngeoms for robot in (sms, boom, ur5)]
    assert shapes[0] == shapes[1] + shapes[2] - 1  # one satellite


def test_names_of_two_equal_models_get_prefixes() -> None:
    arm = pin.buildModelFromUrdf(str(find_arm("ur5")[0]))
    arm.armature[:] = 0.1
    sms = ffsms.mount([arm, arm], locked={"arm2_elbow_joint": 0.3})
    names = [name for name in arm.names if name != "universe"]
    assert sms.joint_names[:6] == [f"arm1_{name}" for name in names]
    assert "arm2_elbow_joint" not in sms.joint_names
    assert sms.n == 11
    assert sms.model.armature[6:].tolist() == [0.1] * 11
    assert sms.end_effectors == ["arm1_tool0", "arm2_tool0"]


def test_a_plan_with_goals_for_both_tools_reaches(mixed: ffsms.SpaceManipulator) -> None:
    sms = mixed.with_end_effector("panda_hand_tcp")
    q0 = sms.home()
    tool = sms.at(q0).frame("tool0").pose.translation
    goal = sms.at(q0).end_effector_pose.translation + np.array([0.05, 0.05, 0.0])
    plan = opt.plan(sms, q0, goal, 10.0, 0.05, also={"tool0": tool})
    assert plan.reached, plan.note


@pytest.mark.parametrize(
    ("arms", "options", "kind", "fragments"),
    [
        ([], {}, InvalidValue, "arm must name at least one arm"),
        (["panda", 3], {}, InvalidValue, "arm[1] must be the name of an arm, a path or a pinocchio.Model"),
        (["panda", "nope"], {}, ModelNotFound, "no robot 'nope'"),
        (["panda", "ur5"], {"placement": pin.SE3.Identity()}, InvalidValue, "for each of the 2 arms"),
        (["panda", "ur5"], {"placement": [np.eye(3), np.eye(4)]}, InvalidValue, "placement[0] must be"),
        (
            ["panda", "ur5"],
            {"locked": {"elbow": 0.0}},
            InvalidValue,
            "locked must name moving joints of the arm",
        ),
        (["panda", "ur5"], {"visual": pin.GeometryModel()}, InvalidValue, "visual is allowed only"),
    ],
)
def test_arms_that_cannot_be_mounted(
    arms: list[Any], options: dict[str, Any], kind: type[FfsmsError], fragments: str, refused: Refused
) -> None:
    refused(lambda: ffsms.mount(arms, **options), kind, fragments)
