"""The paper's collision points: which count, their clearances and gradients."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.check_points import CheckPoints


@pytest.fixture
def points(planar: ffsms.SpaceManipulator) -> CheckPoints:
    return CheckPoints(planar)


def planar_points(joints: np.ndarray) -> np.ndarray:
    """d_1 to d_4 of the planar arm in base axes, by hand."""
    angles = np.cumsum(joints)
    steps = 0.3 * np.array([[np.cos(a), np.sin(a)] for a in angles])
    mount = np.array([[0.232, 0.0]])
    return np.vstack([mount, mount + np.cumsum(steps, axis=0)])


def test_only_what_can_change_counts(points: CheckPoints) -> None:
    assert points.names() == [
        "joint_1 - joint_3",
        "joint_1 - end_effector",
        "joint_2 - end_effector",
        "joint_2 - base box",
        "joint_3 - base box",
        "end_effector - base box",
    ]


def test_values_are_those_of_plane_geometry_and_ignore_the_base_pose(
    planar: ffsms.SpaceManipulator, points: CheckPoints
) -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        joints = rng.uniform(planar.limits.lower, planar.limits.upper)
        d = planar_points(joints)
        box = np.abs(d[1:]) - 0.232
        expected = [
            np.linalg.norm(d[2] - d[0]),
            np.linalg.norm(d[3] - d[0]),
            np.linalg.norm(d[3] - d[1]),
            # Outside where at least one of const5 to const7 holds; the third cannot in the plane.
            *np.maximum(box.max(axis=1), -0.483 / 2),
        ]
        q = planar.configuration(joints, base=pin.SE3.Random())
        np.testing.assert_allclose(points.evaluate(q).value, expected, atol=1e-12)


def test_gradients_are_finite_differences(planar: ffsms.SpaceManipulator, points: CheckPoints) -> None:
    rng = np.random.default_rng(2)
    h = 1e-6
    for _ in range(10):
        joints = rng.uniform(planar.limits.lower, planar.limits.upper)
        base = pin.SE3.Random()
        gradient = points.evaluate(planar.configuration(joints, base)).gradient
        for i in range(planar.n):
            change = h * np.eye(planar.n)[i]
            ahead = points.evaluate(planar.configuration(joints + change, base)).value
            behind = points.evaluate(planar.configuration(joints - change, base)).value
            np.testing.assert_allclose(gradient[:, i], (ahead - behind) / (2.0 * h), atol=1e-7)


def test_a_base_without_a_box_is_said(planar: ffsms.SpaceManipulator) -> None:
    bare = ffsms.SpaceManipulator(planar.model, "end_effector")
    with pytest.raises(InvalidValue, match="base_size"):
        CheckPoints(bare)
