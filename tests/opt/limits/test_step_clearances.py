"""Clearances of points and shapes: their pairs, values, gradients and rows."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from clearances_at import At, Points
from motions import random_pose

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.geometry.bodies import clearance_stack
from ffsms_pin.opt.step.state import StepState


def planar_points(joints: FloatArray) -> FloatArray:
    """Return d_1 to d_4 of the planar arm in base axes, by plane geometry."""
    angles = np.cumsum(joints)
    steps = 0.3 * np.array([[np.cos(a), np.sin(a)] for a in angles])
    mount = np.array([[0.232, 0.0]])
    return np.vstack([mount, mount + np.cumsum(steps, axis=0)])


def plain_points(sms: ffsms.SpaceManipulator, points: Points, q: FloatArray) -> FloatArray:
    """Return the clearances pair by pair from Pinocchio's poses."""
    data = sms.model.createData()
    pin.framesForwardKinematics(sms.model, data, q)
    places = [data.oMi[j].translation for j in range(2, sms.model.njoints)]
    places.append(data.oMf[sms.frame_id].translation)
    values = [np.linalg.norm(places[i] - places[j]) for i, j in zip(points.first, points.second, strict=True)]
    box = data.oMi[1] * sms.base_box_placement
    half = 0.5 * np.array(sms.base_size)
    values += [(np.abs(box.actInv(places[i])) - half).max() for i in points.outside]
    return np.array(values)


def test_only_pairs_whose_distance_can_change_are_named(planar: ffsms.SpaceManipulator) -> None:
    points = Points(planar)
    assert points.count == 6
    assert points.names() == [
        "joint_1 - joint_3",
        "joint_1 - end_effector",
        "joint_2 - end_effector",
        "joint_2 - base box",
        "joint_3 - base box",
        "end_effector - base box",
    ]


def test_point_clearances_agree_with_plane_geometry_for_any_base_pose(planar: ffsms.SpaceManipulator) -> None:
    points, rng = Points(planar), np.random.default_rng(1)
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
        np.testing.assert_allclose(points.values(q), expected, atol=1e-12)


@pytest.mark.parametrize("mode", ["points", "shapes"])
@pytest.mark.parametrize("name", ["planar_3r", "satellite_panda"])
def test_gradients_agree_with_finite_differences(name: str, mode: str) -> None:
    sms, rng, h = ffsms.load(name), np.random.default_rng(3), 1e-6
    stack = clearance_stack(sms, mode)
    assert stack is not None
    model = Points(sms) if mode == "points" else At(stack)
    checked = 0
    for _ in range(6):
        joints, base = rng.uniform(sms.limits.lower, sms.limits.upper), random_pose(rng)
        q = sms.configuration(joints, base)
        value, gradient = model.gradients(q)
        assert value.shape == (model.count,) == (len(model.names()),)
        np.testing.assert_allclose(model.values(q), value, rtol=0.0, atol=1e-12)
        if isinstance(model, Points):
            np.testing.assert_allclose(value, plain_points(sms, model, q), atol=1e-12)
        for i in range(sms.n):
            change = h * np.eye(sms.n)[i]
            ahead = model.values(sms.configuration(joints + change, base))
            behind = model.values(sms.configuration(joints - change, base))
            slope = (ahead - behind) / (2.0 * h)
            if mode == "points":
                np.testing.assert_allclose(gradient[:, i], slope, atol=1e-6)
            # The distance of shapes has kinks where the nearest features change.
            smooth = (np.abs(ahead - 2.0 * value + behind) < 1e-9) & (value > 1e-3)
            np.testing.assert_allclose(gradient[smooth, i], slope[smooth], atol=2e-3)
            checked += int(smooth.sum())
    assert checked > 3 * sms.n * model.count


@pytest.mark.parametrize("kinds", [("revolute",), ("revolute", "continuous"), ("revolute", "prismatic")])
def test_gradients_on_branched_arms_agree_with_finite_differences(
    random_tree: Callable[..., Any], kinds: tuple[str, ...]
) -> None:
    rng, h = np.random.default_rng(4), 1e-6
    for seed in range(4):
        sms = ffsms.SpaceManipulator(random_tree(seed, 5, kinds).model(), "tip", (0.5, 0.4, 0.3))
        points = Points(sms)
        joints, base = rng.uniform(-1.0, 1.0, sms.n), random_pose(rng)
        _, gradient = points.gradients(sms.configuration(joints, base))
        for i in range(sms.n):
            change = h * np.eye(sms.n)[i]
            ahead = points.values(sms.configuration(joints + change, base))
            behind = points.values(sms.configuration(joints - change, base))
            np.testing.assert_allclose(gradient[:, i], (ahead - behind) / (2.0 * h), atol=1e-6)


def test_shapes_connected_by_a_joint_are_no_pair(panda: ffsms.SpaceManipulator) -> None:
    stack = clearance_stack(panda, "shapes")
    assert stack is not None
    names, joined = stack.names, set()
    body = panda.layout.body_name
    for j in range(2, panda.model.njoints):
        joined.add(f"{body(panda.model, int(panda.model.parents[j]))} - {body(panda.model, j)}")
    assert len(names) == len(set(names)) > 10
    assert not joined & set(names)


def test_results_stay_valid_after_further_evaluations(panda: ffsms.SpaceManipulator) -> None:
    """Results are no views of reused buffers, and copies of the object have buffers of their own."""
    rng = np.random.default_rng(4)
    first, second = (
        panda.configuration(rng.uniform(panda.limits.lower, panda.limits.upper)) for _ in range(2)
    )
    bodies = clearance_stack(panda, "hulls")
    assert bodies is not None
    for model in (Points(panda), At(bodies)):
        result = model.gradients(first)
        kept = [array.copy() for array in result]
        model.gradients(second)
        for other in (copy.deepcopy(model), pickle.loads(pickle.dumps(model))):
            other.gradients(second)
            for before, now, again in zip(kept, result, other.gradients(first), strict=True):
                np.testing.assert_array_equal(before, now)
                np.testing.assert_array_equal(before, again)


def test_rows_bound_the_rate_of_a_clearance_by_its_slack(panda: ffsms.SpaceManipulator) -> None:
    q = panda.configuration(0.5 * (panda.limits.lower + panda.limits.upper))
    points = Points(panda)
    value, gradient = points.gradients(q)
    limit = opt.Clearance(0.01, "points").for_robot(panda)
    rows = limit.rows(StepState(panda, q, np.zeros(7), 0.01, 5.0))
    assert rows is not None
    np.testing.assert_allclose(rows.G, gradient, rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(rows.lower, -2.0 * (value - 0.012), rtol=0.0, atol=1e-14)
    assert (rows.upper >= 1e20).all()
    assert rows.softness == 1.0


def test_wrong_modes_and_a_missing_base_size_are_refused(planar: ffsms.SpaceManipulator) -> None:
    bare = ffsms.SpaceManipulator(planar.model, "end_effector")
    with pytest.raises(InvalidValue, match="base_size"):
        Points(bare)
    with pytest.raises(InvalidValue, match="collision"):
        clearance_stack(planar, "spheres")
    assert clearance_stack(planar, "off") is None
