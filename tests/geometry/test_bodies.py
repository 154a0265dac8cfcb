"""Test clearances between bodies: convex parts, gradients, screening, and sharing between robots."""

from __future__ import annotations

from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
import pytest
from clearances_at import At
from meshes import ARMS, Meshes, random_joints
from motions import random_pose

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.errors import InvalidValue
from ffsms_pin.geometry.bodies import BodyStack, body_pairs, chosen_mode
from ffsms_pin.geometry.convex_parts import part_of
from ffsms_pin.geometry.distances import PartPairs, Poses


@pytest.fixture(scope="module", params=ARMS)
def robot(request: pytest.FixtureRequest) -> ffsms.SpaceManipulator:
    return ffsms.load(request.param)


def test_parts_are_never_further_apart_than_shapes(robot: ffsms.SpaceManipulator) -> None:
    stack, meshes = BodyStack(robot, "hulls", 0.01), Meshes(robot)
    q = random_joints(robot, 12, 1)
    values = stack.values(Poses.of(q))
    exact = np.array([meshes.distances(robot.configuration(row), stack.names) for row in q.T]).T
    apart = exact > 0.0
    assert (values <= exact + 1e-6)[apart].all()
    assert (values[~apart] <= 1e-6).all()
    # The bound is tight; a bound of zero would pass the lines above.
    assert np.median((exact - values)[apart]) < 2e-3


def test_screening_loses_nothing(robot: ffsms.SpaceManipulator) -> None:
    stack, q = BodyStack(robot, "hulls", 0.01), random_joints(robot, 40, 2)
    screened = stack.values(Poses.of(q), 0.05)
    # Compute the distances of all pairs of parts by Coal, with poses by Pinocchio.
    model, data, parts = robot.model, robot.model.createData(), robot.convex_parts()
    pairs, request = body_pairs(robot, [part.body for part in parts]), coal.DistanceRequest()
    for k, row in enumerate(q.T[:15]):
        base = np.zeros(robot.nq)
        base[:] = robot.configuration(row)
        pin.forwardKinematics(model, data, base)
        root = data.oMi[1].inverse()
        at = []
        for part in parts:
            pose = root * data.oMi[part.body + 2]
            at.append(coal.Transform3s(pose.rotation, pose.translation) * part.place)
        for m, (a, b) in enumerate(pairs):
            brute = min(
                coal.distance(part_a.shape, at[i], part_b.shape, at[j], request, coal.DistanceResult())
                for i, part_a in enumerate(parts)
                for j, part_b in enumerate(parts)
                if (part_a.body, part_b.body) == (a, b)
            )
            value = screened[m, k]
            if brute < 0.05 - 1e-6:
                assert value == pytest.approx(brute, abs=1e-6)
            else:
                assert 0.05 - 1e-6 <= value <= brute + 1e-6


@pytest.mark.parametrize("mode", ["hulls", "shapes"])
def test_near_pairs_are_found_with_their_gradients(robot: ffsms.SpaceManipulator, mode: str) -> None:
    stack, near = BodyStack(robot, mode, 0.01), 0.03
    poses = Poses.of(random_joints(robot, 20, 4))
    everywhere = stack.values(poses)
    where, nearest = stack.below(poses, np.full(len(stack.names), near))
    value, slopes = nearest.distance, stack.slopes(poses, where, nearest)[0]
    assert value.size > 5
    # The found entries are exactly those below `near`, in another order.
    found = np.zeros(everywhere.shape, dtype=bool)
    found[where] = True
    np.testing.assert_array_equal(found, everywhere < near)
    apart = value > 0.0  # the depth of overlapping meshes depends on the evaluated triangles
    np.testing.assert_allclose(value[apart], everywhere[where][apart], atol=1e-9)
    at = where[0][apart], where[1][apart]
    alone = stack.slopes(poses, at, stack.nearest(poses, at))[0]
    np.testing.assert_allclose(slopes[:, apart], alone, atol=1e-4)


def test_shapes_that_are_screened_are_measured_as_by_pinocchio(robot: ffsms.SpaceManipulator) -> None:
    stack, meshes, near = BodyStack(robot, "shapes", 0.01), Meshes(robot), 0.05
    q = random_joints(robot, 12, 5)
    values = stack.values(Poses.of(q), near)
    exact = np.array([meshes.distances(robot.configuration(row), stack.names) for row in q.T]).T
    close = exact < near - 1e-6
    assert close.sum() > 5
    assert (values[~close] >= near - 1e-6).all()
    apart = close & (exact > 1e-6)
    np.testing.assert_allclose(values[apart], exact[apart], atol=1e-6)
    assert (values[close & ~apart] <= 1e-6).all()


def test_gradients(robot: ffsms.SpaceManipulator) -> None:
    stack, h = BodyStack(robot, "hulls", 0.01), 1e-5
    q = random_joints(robot, 12, 3)
    poses = Poses.of(q)
    values = stack.values(poses)
    where = np.nonzero((values > 1e-3) & (values < 0.3))
    assert where[0].size > 20
    slopes = stack.slopes(poses, where, stack.nearest(poses, where))[0]
    wrong = np.zeros(slopes.shape)
    for j in range(robot.n):
        ends = []
        for change in (h, -h):
            moved = q.copy()
            moved[j] += change
            ends.append(stack.values(Poses.of(moved))[where])
        wrong[j] = np.abs((ends[0] - ends[1]) / (2.0 * h) - slopes[j])
    # A distance is not differentiable where the nearest points jump between faces or parts.
    assert np.mean(wrong.max(axis=0) < 1e-3) > 0.9
    assert np.median(wrong) < 1e-5


def test_rows_omit_only_inactive_pairs(robot: ffsms.SpaceManipulator) -> None:
    stack = BodyStack(robot, "hulls", 0.01)
    model = At(stack)
    q, fastest = robot.configuration(random_joints(robot, 1, 5)[:, 0]), np.full(robot.n, 0.2)
    value, gradient = model.gradients(q)
    near_value, near_gradient = model.gradients(q, 0.012 + stack.reaches @ fastest / 2.0)
    same = np.abs(near_gradient - gradient).max(axis=1) < 1e-12
    assert same.any()
    assert not same.all()
    np.testing.assert_allclose(near_value[same], value[same], atol=1e-9)
    assert (np.abs(gradient[~same]) @ fastest <= 2.0 * (near_value[~same] - 0.012) + 1e-9).all()


@pytest.mark.parametrize("mode", ["hulls", "shapes"])
def test_a_single_configuration_equals_a_row_of_a_stack(robot: ffsms.SpaceManipulator, mode: str) -> None:
    """Distances agree to 1e-14 and gradients to 1e-9, for a random base pose."""
    stack, joints, base = (
        BodyStack(robot, mode, 0.01),
        random_joints(robot, 8, 9),
        random_pose(np.random.default_rng(9)),
    )
    poses = Poses.of(joints)
    every = stack.every(poses)
    nearest = stack.nearest(poses, every)
    shape = len(joints.T), len(stack.names)
    slopes = stack.slopes(poses, every, nearest)[0].reshape(-1, *shape)
    for k, row in enumerate(joints.T):
        value, gradient = At(stack).gradients(robot.configuration(row, base))
        np.testing.assert_allclose(value, nearest.distance.reshape(shape)[k], rtol=0.0, atol=1e-14)
        np.testing.assert_allclose(gradient, slopes[:, k].T, rtol=0.0, atol=1e-9)


def test_the_default_collision_mode(robot: ffsms.SpaceManipulator) -> None:
    assert chosen_mode(robot) == "hulls"
    assert chosen_mode(ffsms.load("planar_3r")) == "points"
    assert opt.Clearance(collision="auto").for_robot(robot).left_out == []


def test_pairs_that_are_near_by_construction_are_left_out(robot: ffsms.SpaceManipulator) -> None:
    wide = opt.Clearance(0.25, "hulls").for_robot(robot)
    assert wide.left_out
    assert len(wide.left_out) < len(opt.Clearance(0.01, "hulls").for_robot(robot).left_out) + 21


def test_a_clearance_that_no_bodies_can_keep_is_refused(robot: ffsms.SpaceManipulator) -> None:
    with pytest.raises(InvalidValue, match="clearance must be smaller: no two bodies"):
        opt.Clearance(1e3, "hulls").for_robot(robot)


def test_robots_of_other_masses_share_their_clearance_stack(robot: ffsms.SpaceManipulator) -> None:
    geometry, limit = robot.geometry("collision"), opt.Clearance().for_robot(robot)
    bodies = list(robot.model.inertias)[1:]
    heavier = robot.with_inertias([pin.Inertia(1.2 * b.mass, b.lever, 1.2 * b.inertia) for b in bodies])
    assert heavier.geometry("collision") is geometry
    assert limit.for_robot(heavier)._stacks[0] is limit._stacks[0]
    # Stacks are not shared between other joint limits, clearances, robots or collision modes.
    limits = robot.limits
    narrower = ffsms.RobotLimits(
        0.5 * limits.lower, 0.5 * limits.upper, limits.velocity, limits.acceleration, limits.torque
    )
    for other in (
        limit.for_robot(robot.with_limits(narrower)),
        replace(limit, clearance=0.011).for_robot(robot),
    ):
        assert other._stacks[0] is not limit._stacks[0]
    assert limit.for_robot(ffsms.load("space_arm_7"))._stacks[0] is not limit._stacks[0]
    assert replace(limit, collision="points").for_robot(robot)._stacks[0] is not limit._stacks[0]
    joints, kept = random_joints(robot, 3, 5), limit._stacks[0]
    assert kept is not None
    poses = Poses.of(joints)
    np.testing.assert_array_equal(kept.values(poses), BodyStack(heavier, "hulls", 0.01).values(poses))


def test_parts_of_all_kinds_are_measured_as_by_coal() -> None:
    """Test separate and overlapping parts; nearest points and normal agree with the distance."""
    robot = ffsms.load("planar_3r")
    rng, corners = np.random.default_rng(12), coal.StdVec_Vec3s()
    corners.extend(list(rng.uniform(-0.1, 0.1, (30, 3))))
    shapes = [
        coal.Box(0.1, 0.2, 0.3),
        coal.Sphere(0.1),
        coal.Capsule(0.05, 0.3),
        coal.Cylinder(0.1, 0.2),
        coal.Cone(0.1, 0.2),
        coal.Ellipsoid(0.1, 0.15, 0.2),
        coal.ConvexBase.convexHull(corners, True, "Qt"),
    ]
    request, joints = coal.DistanceRequest(), np.zeros((robot.n, 1))
    where = np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int64)
    overlapping = 0
    for shape_a in shapes:
        for shape_b in shapes:
            for spread in (0.1, 0.4, 2.0):
                near, far = random_pose(rng), random_pose(rng)
                near.translation, far.translation = rng.normal(0.0, 0.1, 3), rng.normal(0.0, spread, 3)
                first, second = part_of(shape_a, -1, near, True), part_of(shape_b, robot.n, far, True)
                pairs = PartPairs(robot.arm_stack(), [([first], [second])])
                poses = Poses(joints, np.eye(3)[:, :, None, None], np.zeros((3, 1, 1)))
                distance, points = pairs.nearest(poses, where)
                result = coal.DistanceResult()
                by_coal = coal.distance(shape_a, first.place, shape_b, second.place, request, result)
                assert distance[0] == pytest.approx(by_coal, abs=2e-5)
                here, there, normal = points[0]
                np.testing.assert_allclose(there - here, distance[0] * normal, atol=2e-5)
                overlapping += int(by_coal < 0.0)
    assert 20 < overlapping < 120
