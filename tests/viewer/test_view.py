"""Test the objects of the viewer's scenes and their animations."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import umsgpack
from exported import ExportedPage

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.viewer import LAYERS, View, view


@pytest.fixture(scope="module")
def scene(planar: ffsms.SpaceManipulator, plan: opt.Trajectory, tracking: ffsms.Tracking) -> View:
    return view(planar, tracking, plan, fps=10.0)


@pytest.fixture(scope="module")
def opened(scene: View) -> ExportedPage:
    return ExportedPage(scene.html())


def test_the_page_loads_nothing_external(opened: ExportedPage) -> None:
    assert not re.search(r"""(?:src|href)\s*=\s*["']?(?:https?:)?//""", opened.text)
    assert not re.search(r"@import|url\(\s*[\"']?https?:", opened.text)
    # Meshcat's script contains addresses (licences, XML name spaces), but fetches none of them.
    start, end = opened.text.index("<script>"), opened.text.index('id="facts"')
    assert "://" not in opened.text[:start] + opened.text[end:]


def test_the_arm_is_where_pinocchio_puts_it(
    planar: ffsms.SpaceManipulator, tracking: ffsms.Tracking, opened: ExportedPage
) -> None:
    data = planar.model.createData()
    for shape in planar.geometry("visual").geometryObjects:
        times, places = opened.track(f"robot/visuals/{shape.name}", "position")
        _, turns = opened.track(f"robot/visuals/{shape.name}", "quaternion")
        assert times[-1] == pytest.approx(12.0)
        for k in (0, len(times) // 2, len(times) - 1):
            row = int(np.argmin(np.abs(tracking.t - times[k])))
            pin.forwardKinematics(planar.model, data, tracking.q[row])
            pose = data.oMi[shape.parentJoint] * shape.placement
            np.testing.assert_allclose(places[k], pose.translation, atol=1e-6)
            turned = pin.Quaternion(*turns[k][[3, 0, 1, 2]]).normalized().toRotationMatrix()
            np.testing.assert_allclose(turned, pose.rotation, atol=1e-6)


def test_arrow_to_the_target_ends_at_it_or_points_there(
    planar: ffsms.SpaceManipulator, plan: opt.Trajectory, opened: ExportedPage
) -> None:
    _, tips = opened.track("direction d", "position")
    _, turns = opened.track("direction d", "quaternion")
    _, scales = opened.track("direction d", "scale")
    longest = scales[:, 2].max()
    for tip, turn, scale in zip(tips[:100], turns[:100], scales[:100], strict=True):
        ahead = plan.target - tip
        distance = float(np.linalg.norm(ahead))
        pointing = pin.Quaternion(*turn[[3, 0, 1, 2]]).normalized().toRotationMatrix()[:, 2]
        np.testing.assert_allclose(pointing, ahead / distance, atol=1e-5)
        assert scale[2] == pytest.approx(min(distance, longest), rel=1e-5)


def test_cone_opens_at_the_ideal_angle(
    planar: ffsms.SpaceManipulator, tracking: ffsms.Tracking, plan: opt.Trajectory, opened: ExportedPage
) -> None:
    times, scales = opened.track("cone of the cost", "scale")
    for k in range(0, len(times), 15):
        row = int(np.argmin(np.abs(tracking.t - times[k])))
        sigma = np.linalg.svd(planar.at(tracking.q[row]).C_bm, compute_uv=False)
        share = sigma[sigma > 0.0] / sigma.sum()
        entropy = -float((share * np.log(share)).sum()) / np.log(planar.n)
        ideal = np.log(np.exp(plan.kappa * (1.0 - entropy)) - 1.0) / plan.kappa
        assert np.arctan2(scales[k, 0], scales[k, 2]) == pytest.approx(np.arccos(ideal), abs=1e-4)


def test_base_arrow_is_the_dominant_motion_with_the_sign_of_the_joint_rates(
    planar: ffsms.SpaceManipulator, tracking: ffsms.Tracking, opened: ExportedPage
) -> None:
    times, turns = opened.track("base motion u1/translation", "quaternion")
    _, scales = opened.track("base motion u1/translation", "scale")
    ratios = []
    for k in range(5, len(times) - 5, 10):
        row = int(np.argmin(np.abs(tracking.t - times[k])))
        C = planar.at(tracking.q[row]).C_bm
        U, sigma, Vt = np.linalg.svd(C)
        sign = 1.0 if Vt[0] @ tracking.v[row, 6:] > 0.0 else -1.0
        expected = sign * sigma[0] * U[:3, 0]
        pointing = pin.Quaternion(*turns[k][[3, 0, 1, 2]]).normalized().toRotationMatrix()[:, 2]
        np.testing.assert_allclose(pointing, expected / np.linalg.norm(expected), atol=1e-4)
        ratios.append(scales[k, 2] / np.linalg.norm(expected))
    np.testing.assert_allclose(ratios, ratios[0], rtol=1e-4)  # the scale is constant


def test_cone_takes_the_colour_of_the_assistance(
    planar: ffsms.SpaceManipulator, tracking: ffsms.Tracking, plan: opt.Trajectory, opened: ExportedPage
) -> None:
    times, colours = opened.track("cone of the cost/<object>", "material.color")
    grey, blue = np.array([0xB5, 0xB0, 0xA8]) / 255.0, np.array([0x00, 0x72, 0xB2]) / 255.0
    k = len(times) // 2
    row = int(np.argmin(np.abs(tracking.t - times[k])))
    state = planar.at(tracking.q[row], tracking.v[row])
    ahead = plan.target - state.end_effector_pose.translation
    moving = state.end_effector_twist[:3]
    cosine = float(moving @ ahead / np.linalg.norm(moving) / np.linalg.norm(ahead))
    assert 0.5 < cosine < 1.0
    np.testing.assert_allclose(colours[k], grey + cosine * (blue - grey), atol=1e-4)


def test_layers_exist_and_are_shown_on_request(
    planar: ffsms.SpaceManipulator, plan: opt.Trajectory, opened: ExportedPage
) -> None:
    # Layers of other scenes are tested in test_obstacle_layer.py and test_surroundings.py.
    around = {"obstacles", "path", "client", "client_path", "actuators", "contact", "events"}
    assert {layer["name"] for layer in opened.facts["layers"]} == set(LAYERS) - around
    few = ExportedPage(view(planar, plan, show=("robot", "limits"), fps=2.0).html())
    shown = {layer["name"] for layer in few.facts["layers"] if layer["shown"]}
    assert shown == {"robot", "limits"}
    assert "tracked_path" not in {layer["name"] for layer in few.facts["layers"]}
    visible = {c["path"]: c["value"] for c in few.of("set_property") if c["property"] == "visible"}
    assert visible["/ffsms/robot"] is True
    assert visible["/ffsms/target"] is False


def test_a_scene_without_a_target_has_no_target_layers(
    planar: ffsms.SpaceManipulator, tracking: ffsms.Tracking
) -> None:
    bare = ExportedPage(view(planar, tracking, fps=2.0).html())
    names = {layer["name"] for layer in bare.facts["layers"]}
    assert names.isdisjoint({"target", "direction", "cone", "planned_path"})
    assert {"robot", "base_motion", "tracked_path"} <= names
    assert [reading["label"] for reading in bare.facts["readings"]] == ["entropy"]


def test_a_moving_target_moves(planar: ffsms.SpaceManipulator, tracking: ffsms.Tracking) -> None:
    moving = ExportedPage(view(planar, tracking, target=lambda t: [0.5, 0.1 * t, 0.0], fps=2.0).html())
    times, places = moving.track("target", "position")
    np.testing.assert_allclose(places[:, 1], 0.1 * times, atol=1e-6)


def test_a_robot_without_shapes_is_drawn(random_tree: Callable[..., Any]) -> None:
    tree = random_tree(3, 4, ("revolute",))
    sms = ffsms.SpaceManipulator(tree.model(), "tip", base_size=(0.6, 0.5, 0.4))
    q0 = sms.configuration(np.full(4, 0.3))
    tip = sms.at(q0).end_effector_pose.translation
    plan = opt.plan(
        sms,
        q0,
        tip + np.array([0.0, 0.0, 0.1]),
        duration=2.0,
        dt=0.1,
        method="minimum-effort",
        collision="off",
    )
    opened = ExportedPage(view(sms, plan, fps=2.0, show="all").html())
    drawn = [c["path"] for c in opened.of("set_object") if c["path"].startswith("/ffsms/robot/")]
    assert any("base_box" in path for path in drawn)
    assert sum("link_" in path for path in drawn) >= 3


def test_all_meshes_are_drawn_and_those_at_the_start_are_simplified() -> None:
    sms = ffsms.load("satellite_xarm7")
    q0 = sms.configuration(np.full(sms.n, 0.4))
    tip = sms.at(q0).end_effector_pose.translation
    plan = opt.plan(sms, q0, tip + np.array([0.0, 0.02, 0.0]), duration=1.0, dt=0.1, method="minimum-effort")
    objects = ExportedPage(view(sms, plan, fps=2.0).html()).of("set_object")

    def size(name: str) -> int:
        return sum(len(umsgpack.packb(c)) for c in objects if c["path"].startswith(f"/ffsms/{name}/"))

    names = {c["path"].rsplit("/", 1)[1] for c in objects if c["path"].startswith("/ffsms/robot/")}
    assert names == {shape.name for shape in sms.geometry("visual").geometryObjects}
    assert size("start") < 0.5 * size("robot")
