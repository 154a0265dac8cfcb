"""The paper's collision points: which count, their clearances and gradients."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pinocchio as pin
import pytest
from motions import random_pose

import ffsms_pin as ffsms
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.check_points import CheckPoints


@pytest.fixture
def points(planar: ffsms.SpaceManipulator) -> CheckPoints:
    return CheckPoints(planar)


@pytest.fixture(scope="module")
def panda() -> ffsms.SpaceManipulator:
    return ffsms.load("satellite_panda")


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
        q = planar.configuration(joints, base=random_pose(rng))
        np.testing.assert_allclose(points.evaluate(q).value, expected, atol=1e-12)


def test_gradients_are_finite_differences(planar: ffsms.SpaceManipulator, points: CheckPoints) -> None:
    rng = np.random.default_rng(2)
    h = 1e-6
    for _ in range(10):
        joints = rng.uniform(planar.limits.lower, planar.limits.upper)
        base = random_pose(rng)
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


def plain_clearances(sms: ffsms.SpaceManipulator, points: CheckPoints, q: np.ndarray) -> np.ndarray:
    """The clearances point by point, from Pinocchio's poses."""
    data = sms.model.createData()
    pin.framesForwardKinematics(sms.model, data, q)
    places = [data.oMi[j].translation for j in range(2, sms.model.njoints)]
    places.append(data.oMf[sms.frame_id].translation)
    first, second = points.pairs
    values = [np.linalg.norm(places[i] - places[j]) for i, j in zip(first, second, strict=True)]
    box = data.oMi[1] * sms.base_box_placement
    half = 0.5 * np.array(sms.base_size)
    values += [(np.abs(box.actInv(places[i])) - half).max() for i in points.outside]
    return np.array(values)


def test_a_spatial_arm_has_the_plain_values_and_their_gradients(panda: ffsms.SpaceManipulator) -> None:
    points, rng, h = CheckPoints(panda), np.random.default_rng(3), 1e-6
    for _ in range(5):
        joints = rng.uniform(panda.limits.lower, panda.limits.upper)
        base = random_pose(rng)
        q = panda.configuration(joints, base)
        found = points.evaluate(q)
        np.testing.assert_allclose(found.value, plain_clearances(panda, points, q), atol=1e-12)
        data = panda.model.createData()
        pin.framesForwardKinematics(panda.model, data, q)
        np.testing.assert_array_equal(points.values(data), found.value)
        for i in range(panda.n):
            change = h * np.eye(panda.n)[i]
            ahead = plain_clearances(panda, points, panda.configuration(joints + change, base))
            behind = plain_clearances(panda, points, panda.configuration(joints - change, base))
            np.testing.assert_allclose(found.gradient[:, i], (ahead - behind) / (2.0 * h), atol=1e-6)


def test_what_was_found_stays_when_more_is_asked(panda: ffsms.SpaceManipulator) -> None:
    """Results are no views of what is used again, and copies of the object do not share it."""
    points, rng = CheckPoints(panda), np.random.default_rng(4)
    first, second = (
        panda.configuration(rng.uniform(panda.limits.lower, panda.limits.upper)) for _ in range(2)
    )
    found = points.evaluate(first)
    value, gradient = found.value.copy(), found.gradient.copy()
    points.evaluate(second)
    np.testing.assert_array_equal(found.value, value)
    np.testing.assert_array_equal(found.gradient, gradient)
    for other in (copy.deepcopy(points), pickle.loads(pickle.dumps(points))):
        again = other.evaluate(first)
        np.testing.assert_array_equal(again.value, value)
        np.testing.assert_array_equal(again.gradient, gradient)


def test_points_move_where_pinocchio_gives_copies(planar: ffsms.SpaceManipulator) -> None:
    rng = np.random.default_rng(4)
    q = planar.configuration(rng.uniform(planar.limits.lower, planar.limits.upper), base=random_pose(rng))
    expected = CheckPoints(planar).evaluate(q)
    pin.sharedMemory(False)
    try:
        points = CheckPoints(planar)
        points.evaluate(planar.configuration(np.zeros(3)))
        found = points.evaluate(q)
    finally:
        pin.sharedMemory(True)
    np.testing.assert_array_equal(found.value, expected.value)
    np.testing.assert_array_equal(found.gradient, expected.gradient)
