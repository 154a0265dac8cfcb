"""Invalid obstacles, and starts and targets in collision with obstacles."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
from by_coal import GOAL, START, ByCoal

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.errors import InvalidValue


def tetrahedra() -> Any:
    """Return a mesh that is not convex: two separate tetrahedra."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(8, 8)
    for shift in (0.0, 3.0):
        for face in faces:
            mesh.addTriangle(*(corners[i] + shift for i in face))
    mesh.endModel()
    return mesh


def test_a_convex_mesh_is_accepted() -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(4, 4)
    for face in [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]:
        mesh.addTriangle(*(corners[i] for i in face))
    mesh.endModel()
    obstacle = opt.Obstacle(mesh)
    assert obstacle.distance(np.array([-0.5, 0.2, 0.2]), 0.0) == pytest.approx(0.5, abs=1e-5)
    assert obstacle.distance(np.array([0.05, 0.2, 0.2]), 0.0) == pytest.approx(-0.05, abs=1e-4)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"shape": "box"}, "must be a coal shape"),
        ({"shape": tetrahedra()}, "must be convex: cut it into convex pieces"),
        ({"shape": coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)}, "must be a box"),
        ({"shape": coal.Sphere(0.1), "on": "moon"}, '"inertial", "base", or a client'),
        ({"shape": coal.Sphere(0.1), "on": 3}, '"inertial", "base", or a client'),
        ({"shape": coal.Sphere(0.1), "pose": [0.0, 0.0, 0.0]}, "must be a pinocchio.SE3"),
        ({"shape": coal.Sphere(0.1), "margin": -0.1}, "must be at least zero"),
    ],
)
def test_wrong_obstacles_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InvalidValue, match=message):
        opt.Obstacle(**options)


def test_wrong_lists_and_payloads_are_refused() -> None:
    ball = opt.Obstacle(coal.Sphere(0.1), name="ball")
    with pytest.raises(InvalidValue, match="must have different names"):
        opt.Clearance(obstacles=[ball, ball])
    with pytest.raises(InvalidValue, match=r"sequence of opt\.Obstacle"):
        opt.Clearance(obstacles=ball)  # type: ignore[arg-type]
    with pytest.raises(InvalidValue, match="payload must be a tuple of a coal shape and its"):
        opt.Clearance(payload=coal.Sphere(0.1))


@pytest.mark.parametrize("method", ["horizon", "step"])
def test_a_start_in_contact_and_a_target_inside_are_refused(
    planar: ffsms.SpaceManipulator, method: str
) -> None:
    q0 = planar.configuration(START)
    tip = planar.at(q0).end_effector_pose
    ball = opt.Obstacle(coal.Sphere(0.05), pin.SE3(np.eye(3), tip.translation), name="ball")
    with pytest.raises(InvalidValue, match=r"q0 .* link_3 - ball overlap by [0-9.]+ mm at the start"):
        opt.plan(planar, q0, GOAL, obstacles=[ball], method=method)
    there = opt.Obstacle(coal.Sphere(0.05), pin.SE3(np.eye(3), np.array(GOAL)), name="ball")
    with pytest.raises(InvalidValue, match=r"target .* it is 50\.0 mm inside 'ball'"):
        opt.plan(planar, q0, GOAL, obstacles=[there], method=method)


def test_a_start_below_the_clearance_is_reported(planar: ffsms.SpaceManipulator) -> None:
    q0 = planar.configuration(START)
    tip = planar.at(q0).end_effector_pose.translation
    places = [pin.SE3(np.eye(3), tip + far * np.array([1.0, 1.0, 0.0])) for far in np.arange(0.03, 0.2, 2e-3)]
    shape, by_coal = coal.Sphere(0.05), ByCoal(planar)
    near = next(place for place in places if by_coal(q0, shape, place) > 0.003)
    ball = opt.Obstacle(shape, near)
    plan = opt.plan(planar, q0, GOAL, obstacles=[ball])
    assert not plan.reached
    assert plan.note.startswith("the start violates the clearance: a clearance is violated: link_3 - ")
