"""Arguments of a client, their errors, and clients from files."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin.errors import InvalidUrdf, InvalidValue

BODY = """<robot name="client">
  <link name="bus">
    <inertial><origin xyz="0.1 0 0"/><mass value="60"/>
      <inertia ixx="5" ixy="0" ixz="0" iyy="6" iyz="0" izz="7"/></inertial>
    <collision><origin xyz="0 0 0.2"/><geometry><box size="1 1 0.5"/></geometry></collision>
  </link>
  <link name="ring">
    <inertial><mass value="20"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1.5"/></inertial>
    <collision><geometry><cylinder radius="0.3" length="0.1"/></geometry></collision>
  </link>
  <joint name="bolt" type="{kind}"><parent link="bus"/><child link="ring"/><origin xyz="0 0 0.5"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
</robot>"""


def test_a_client_from_a_file_has_its_masses_and_shapes(tmp_path: Path) -> None:
    path = tmp_path / "client.urdf"
    path.write_text(BODY.format(kind="fixed"))
    pose = pin.SE3(pin.rpy.rpyToMatrix(0.1, 0.2, 0.3), np.array([1.0, 0.0, 0.0]))
    client = ffsms.Client.from_urdf(path, pose, [0.0, 0.0, 0.01, 0.02, 0.0, 0.0])
    com = (60.0 * np.array([0.1, 0.0, 0.0]) + 20.0 * np.array([0.0, 0.0, 0.5])) / 80.0
    expected = np.diag([6.0, 7.0, 8.5])
    for mass, place in ((60.0, [0.1, 0.0, 0.0]), (20.0, [0.0, 0.0, 0.5])):
        d = np.array(place) - com
        expected += mass * (d @ d * np.eye(3) - np.outer(d, d))
    assert client.mass == pytest.approx(80.0)
    np.testing.assert_allclose(client.inertia, expected, atol=1e-12)
    np.testing.assert_allclose(client.link_placement.translation, -com, atol=1e-15)
    box, ring = client.shapes
    assert isinstance(box.geometry, coal.Box)
    assert isinstance(ring.geometry, coal.Cylinder)
    np.testing.assert_allclose(box.placement.translation, np.array([0.0, 0.0, 0.2]) - com, atol=1e-15)
    np.testing.assert_allclose(ring.placement.translation, np.array([0.0, 0.0, 0.5]) - com, atol=1e-15)
    np.testing.assert_allclose(client.pose(10.0).translation, [1.0, 0.0, 0.1], atol=1e-15)


def test_a_file_with_moving_joints_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(BODY.format(kind="revolute"))
    with pytest.raises(InvalidUrdf, match="one rigid body: make its joints fixed \\(bolt\\)"):
        ffsms.Client.from_urdf(path)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"mass": 0.0}, "mass must be above zero"),
        ({"inertia": [1.0, 1.0, 3.0]}, "triangle inequality"),
        ({"inertia": [1.0, 1.0, -1.0]}, "positive definite"),
        ({"inertia": [0.0, 1.0, 1.0]}, "positive definite"),
        ({"inertia": [5e-324, 5e-324, 5e-324]}, "1e-12 kg m\\^2 or more"),
        ({"inertia": [[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]}, "symmetric"),
        ({"inertia": [1.0, np.nan, 1.0]}, "finite"),
        ({"pose": np.eye(3)}, "pose must be a pinocchio.SE3"),
        ({"pose": pin.SE3(2.0 * np.eye(3), np.zeros(3))}, "rotation matrix"),
        ({"twist": [1.0, 2.0, 3.0]}, "twist must have shape \\(6,\\)"),
        ({"shapes": ["box"]}, "coal geometries"),
        ({"shapes": [(coal.Box(1, 1, 1), "here")]}, "placement of a shape"),
        ({"shapes": coal.Box(1, 1, 1)}, "shapes must be a sequence"),
    ],
)
def test_invalid_arguments_are_refused(change: dict[str, object], match: str) -> None:
    values: dict[str, object] = {"mass": 10.0, "inertia": [1.0, 1.0, 1.0]}
    with pytest.raises(InvalidValue, match=match):
        ffsms.Client(**{**values, **change})  # type: ignore[arg-type]


def test_a_client_is_frozen_and_keeps_its_own_copies() -> None:
    pose, inertia = pin.SE3.Identity(), np.diag([1.0, 2.0, 2.5])
    client = ffsms.Client(10.0, inertia, pose, [0.0, 0.0, 0.0, 0.1, 0.2, 0.3])
    pose.translation[0] = inertia[0, 0] = 5.0
    assert client.pose(0.0).translation[0] == 0.0
    assert client.inertia[0, 0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        client.inertia[0, 0] = 5.0
    with pytest.raises(AttributeError):
        client.mass = 5.0  # type: ignore[misc]


def test_a_client_can_be_pickled() -> None:
    place = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.3]))
    shapes = [coal.Box(1.0, 1.0, 0.5), (coal.Cylinder(0.2, 0.1), place)]
    client = ffsms.Client(10.0, [1.0, 2.0, 2.5], None, [0.0, 0.0, 0.0, 0.1, 0.2, 0.3], shapes)
    again = pickle.loads(pickle.dumps(client))
    np.testing.assert_array_equal(again.pose(50.0).homogeneous, client.pose(50.0).homogeneous)
    assert [type(shape.geometry) for shape in again.shapes] == [coal.Box, coal.Cylinder]
    np.testing.assert_array_equal(again.shapes[1].placement.translation, place.translation)


def test_cached_poses_are_not_shared_with_callers() -> None:
    client = ffsms.Client(80.0, [6.0, 9.0, 11.0], None, [0.0, 0.0, 0.01, 0.02, 0.03, 0.0])
    times = np.linspace(0.0, 10.0, 50)
    first = client.poses(times)
    again = client.poses(times.copy())
    for array in again:
        array[:] = np.nan  # returned arrays belong to the caller
    np.testing.assert_array_equal(client.poses(times)[0], first[0])
    np.testing.assert_array_equal(client.poses(times)[1], first[1])
    for k in range(100):
        client.poses(times + k)
    assert len(client._cache) < 20
    np.testing.assert_array_equal(client.poses(times)[1], first[1])
    assert len(pickle.loads(pickle.dumps(client)).poses(times)[0]) == 50


@pytest.mark.parametrize("t", ["1", [1.0, 2.0], np.nan, np.inf])
def test_a_time_must_be_a_finite_number(t: Any) -> None:
    client = ffsms.Client(10.0, np.eye(3))
    for call in (client.pose, client.twist):
        with pytest.raises(InvalidValue, match=r"^t "):
            call(t)
