"""Test clients, wheels, thrusters, contact forces and cameras of the viewer's scene."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.trajectory import measure
from ffsms_pin.viewer import CAMERAS, View, view

AXES = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 1.0] / np.sqrt(3.0), [1.0, 0.0, 0.0]])


@pytest.fixture(scope="module")
def equipped(planar: ffsms.SpaceManipulator) -> ffsms.SpaceManipulator:
    wheels = ffsms.ReactionWheels(AXES, 0.01, 0.1, 1.0)
    thrusters = ffsms.Thrusters(
        [[0.2, 0.2, 0.0], [-0.2, 0.2, 0.0]], [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0]], 1.0, proportional=True
    )
    return planar.with_actuators(wheels=wheels, thrusters=thrusters)


@pytest.fixture(scope="module")
def moved(equipped: ffsms.SpaceManipulator) -> opt.Trajectory:
    problem = opt.Problem(equipped, equipped.configuration([0.4, 0.7, -0.5]), [0.5, 0.5, 0.0], 2.0, 0.5)
    return measure(problem, 0.3 * np.ones((5, 3)))


def track(scene: View, path: str, name: str) -> tuple[Any, Any]:
    times, rows = scene._stage.key_frames._tracks[
        f"/ffsms/{path}", name, "vector3" if name != "quaternion" else name
    ]
    return np.array(times), np.array(rows)


def placed(scene: View, path: str) -> Any:
    """Return the transform (4, 4) of a node."""
    import umsgpack

    packed = scene._stage._commands["set_transform", f"/ffsms/{path}", ""]
    return np.array(umsgpack.unpackb(packed)["matrix"]).reshape(4, 4).T


def test_wheels_are_discs_on_the_base_along_their_axes(
    equipped: ffsms.SpaceManipulator, moved: opt.Trajectory
) -> None:
    scene = view(equipped, moved)
    assert scene.layers["actuators"]
    places = []
    for i, axis in enumerate(AXES):
        matrix = placed(scene, f"wheels/{i}")
        np.testing.assert_allclose(matrix[:3, 2], axis, atol=1e-12)  # the axis of the disc is z
        places.append(matrix[:3, 3])
        inside = np.abs(equipped.base_box_placement.actInv(matrix[:3, 3])) < 0.49 * np.array(
            equipped.base_size
        )
        assert not inside.all()  # the base does not hide the disc
    # Two wheels with the same axis are side by side along it, on the side opposite to the arm.
    assert np.linalg.norm(places[0] - places[3]) > 0.01
    assert all(place[0] < 0.0 for place in (places[0], places[3]))
    _, rows = track(scene, "wheels", "position")
    np.testing.assert_allclose(rows, moved.q[:, :3], atol=1e-12)


def test_thrusters_are_nozzles_that_open_to_the_jet(
    equipped: ffsms.SpaceManipulator, moved: opt.Trajectory
) -> None:
    scene = view(equipped, moved)
    for i, (place, push) in enumerate(
        zip(equipped.thrusters.places, equipped.thrusters.directions, strict=True)  # type: ignore[union-attr]
    ):
        matrix = placed(scene, f"thrusters/{i}")
        np.testing.assert_allclose(matrix[:3, 3], place)
        np.testing.assert_allclose(matrix[:3, 2], -push, atol=1e-12)
    assert "actuators" not in view(equipped.with_actuators(), moved).layers


def test_a_client_moves_with_the_motion(equipped: ffsms.SpaceManipulator, moved: opt.Trajectory) -> None:
    pose = pin.SE3(np.eye(3), np.array([1.0, 0.5, 0.2]))
    twist = np.array([0.05, 0.0, 0.0, 0.0, 0.0, 0.4])
    client = ffsms.Client(5.0, [1.0, 2.0, 2.5], pose, twist, [coal.Box(0.2, 0.3, 0.4)])
    ears = opt.Obstacle(coal.Sphere(0.05), pin.SE3(np.eye(3), np.array([0.0, 0.3, 0.0])), client)
    same = opt.Obstacle(coal.Box(0.2, 0.3, 0.4), on=client)
    scene = view(equipped, moved, client=client, obstacles=[ears, same])
    assert scene.layers["client"]
    assert "obstacles" not in scene.layers  # obstacles on the client belong to its layer
    drawn = {path.split("/")[3] for path in scene._stage.paths if path.startswith("/ffsms/client/")}
    assert drawn == {"0", "1"}  # the client's box once, and the sphere
    assert not scene.layers["frames"]
    times, rows = track(scene, "client", "position")
    _, turns = track(scene, "client", "quaternion")
    for t, row, turn in zip(times, rows, turns, strict=True):
        np.testing.assert_allclose(row, client.pose(t).translation, atol=1e-12)
        rotation = pin.Quaternion(*turn[[3, 0, 1, 2]]).toRotationMatrix()
        np.testing.assert_allclose(rotation, client.pose(t).rotation, atol=1e-9)
    # The camera includes the client.
    far = ffsms.Client(5.0, [1.0, 2.0, 2.5], pin.SE3(np.eye(3), np.array([9.0, 0.0, 0.0])))
    assert view(equipped, moved, client=far)._stage.size > 4.0 > scene._stage.size


def test_a_client_without_shapes_is_a_ball(equipped: ffsms.SpaceManipulator, moved: opt.Trajectory) -> None:
    scene = view(equipped, moved, client=ffsms.Client(5.0, [1.0, 2.0, 2.5]))
    assert "/ffsms/client/0" in scene._stage.paths


def test_the_camera_includes_obstacles_on_a_client_without_shapes(
    equipped: ffsms.SpaceManipulator, moved: opt.Trajectory
) -> None:
    client = ffsms.Client(5.0, [1.0, 2.0, 2.5], pin.SE3(np.eye(3), np.array([3.0, 0.0, 0.0])))
    body = opt.Obstacle(coal.Box(2.0, 0.2, 0.2), on=client)
    scene = view(equipped, moved, client=client, obstacles=[body])
    seen = np.array(scene._facts["seen"]) + scene._facts["centre"]
    assert seen[:, 0].max() == pytest.approx(4.0, abs=1e-3)


def test_cameras(equipped: ffsms.SpaceManipulator, moved: opt.Trajectory) -> None:
    for name in CAMERAS:
        scene = view(equipped, moved, camera=name)
        assert f'"camera": "{name}"' in scene.html()
    with pytest.raises(InvalidValue, match='"free" or "front" or "side" or "top" or "base"'):
        view(equipped, moved, camera="behind")
    # The page uses these to keep the base at its initial pose (test_exported_page.py).
    np.testing.assert_allclose(scene._facts["base"], moved.q[0, :7])
    _, places = track(scene, "base", "position")
    _, turns = track(scene, "base", "quaternion")
    for place, turn, q in zip(places, turns, moved.q, strict=True):
        np.testing.assert_allclose(place, q[:3], atol=1e-12)
        assert abs(turn @ q[3:7]) == pytest.approx(1.0)  # q and -q are the same attitude


def test_the_contact_force_is_an_arrow_during_contact(
    equipped: ffsms.SpaceManipulator, moved: opt.Trajectory
) -> None:
    """A contact of a single row between two frames is shown; lengths are proportional to the force."""
    flown = ffsms.simulate(equipped, moved, ffsms.SlidingModeController(equipped), dt=0.01)
    wrench = np.zeros((len(flown.t), 6))
    wrench[52, :3], wrench[131, :3] = [0.0, -8.0, 0.0], [4.0, 0.0, 0.0]
    scene = view(equipped, replace(flown, contact_wrench=wrench), fps=10.0)
    assert scene.layers["contact"]
    times, sizes = track(scene, "contact force", "scale")
    lengths = sizes[:, 2]
    hard, soft = np.flatnonzero(lengths > 1e-3)
    assert times[hard] == pytest.approx(0.5, abs=0.1)
    assert times[soft] == pytest.approx(1.3, abs=0.1)
    assert lengths[hard] == pytest.approx(2.0 * lengths[soft])
    _, turns = track(scene, "contact force", "quaternion")
    np.testing.assert_allclose(pin.Quaternion(turns[hard]).matrix()[:, 2], [0.0, -1.0, 0.0], atol=1e-12)
    reading = scene._facts["readings"][-1]
    assert (reading["label"], max(reading["values"])) == ("contact", 8.0)
    assert "contact" not in view(equipped, flown).layers
