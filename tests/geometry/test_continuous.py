"""Test clearances along motions: at few instants, between instants, and with exact meshes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from meshes import ARMS, Meshes, random_joints

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.geometry.bodies import BodyStack
from ffsms_pin.geometry.distances import Entries, Nearest, Poses, least_of
from ffsms_pin.opt.rollouts import rolled_out
from ffsms_pin.opt.trajectory import measure


@pytest.fixture(scope="module", params=ARMS)
def robot(request: pytest.FixtureRequest) -> ffsms.SpaceManipulator:
    return ffsms.load(request.param)


def test_no_distance_changes_faster_than_its_bound(robot: ffsms.SpaceManipulator) -> None:
    stack = BodyStack(robot, "hulls", 0.01)
    rng, q = np.random.default_rng(4), random_joints(robot, 60, 4)
    change = rng.uniform(-0.2, 0.2, q.shape)
    before, after = (stack.values(Poses.of(place)) for place in (q, q + change))
    bound = stack.reaches @ np.abs(change)
    assert (np.abs(after - before) <= bound + 1e-6).all()
    assert (stack.reaches[stack.reaches > 0.0] < 3.0).all()


class Counted(BodyStack):
    """A stack that counts the computed distances."""

    computed = 0

    def nearest(self, poses: Poses, where: Entries, near: Any = np.inf) -> Nearest:
        self.computed += len(where[0])
        return super().nearest(poses, where, near)


def test_few_distances_along_a_motion_give_the_exact_minimum(robot: ffsms.SpaceManipulator) -> None:
    """Distances and their largest rates determine the instants at which distances are computed."""
    start, end = random_joints(robot, 2, 7).T
    problem = opt.Problem(robot, robot.configuration(start), np.ones(3), 2.0, 0.01, limits=[])
    rates = np.tile((end - start) / 2.0, (201, 1))
    motion = rolled_out(robot, problem.stack, problem.q0, rates, 0.01, problem.momentum)
    stack, binding = BodyStack(robot, "hulls", 0.01), 0.02
    exact = stack.values(stack.along(motion))
    least = float(exact.min())
    for clearance in (least - 0.01, least + 1e-3, least + 0.03):
        counted = Counted(robot, "hulls", 0.01)
        counted.computed = 0
        minimum = least_of(counted, motion, clearance, binding)
        assert 0 < counted.computed < 0.5 * exact.size
        np.testing.assert_array_equal(minimum.near, motion.times[(exact < clearance + binding).any(axis=0)])
        if clearance > least:
            shapes = stack.refined(
                stack.along(motion), np.nonzero(exact < clearance), exact[exact < clearance]
            )
            assert minimum.value == pytest.approx(float(shapes.min()), abs=1e-9)


@pytest.mark.parametrize("name", ARMS)
def test_a_collision_between_two_instants_is_detected(name: str) -> None:
    """The instants of the plan are clear, and the motion between them is not."""
    sms = ffsms.load(name)
    limit = opt.Clearance(0.01, "hulls")
    rng = np.random.default_rng(6)
    stack, meshes = BodyStack(sms, "hulls", 0.01), Meshes(sms)
    for _ in range(2000):
        ends = random_joints(sms, 2, int(rng.integers(1 << 30)))
        path = ends[:, :1] + np.linspace(0.0, 1.0, 41) * (ends[:, 1:] - ends[:, :1])
        watched = path[:, [0, 20, 40]]
        if stack.values(Poses.of(watched), 0.02).min() > 0.012:
            least = stack.values(Poses.of(path), 0.02).min()
            if least < -0.01:
                break
    assert least < -0.01
    rates = np.tile((ends[:, 1] - ends[:, 0]) / 1.0, (2, 1))
    problem = opt.Problem(
        sms, sms.configuration(ends[:, 0]), np.ones(3), duration=1.0, dt=1.0, limits=[limit]
    )
    plan = measure(problem, rates)
    assert not plan.clear
    assert "clearance" in plan.broken
    assert not any(meshes.collide(sms.configuration(path[:, k])) for k in (0, 20, 40))


@pytest.mark.parametrize(("name", "turn"), [("satellite_panda", 1.0), ("satellite_ur10", 1.0)])
def test_plans_do_not_penetrate(name: str, turn: float) -> None:
    """Check exact meshes at nodes and midpoints of plans to reachable positions."""
    sms, rng = ffsms.load(name), np.random.default_rng(7)
    stack, meshes = BodyStack(sms, "hulls", 0.01), Meshes(sms)
    drawn = random_joints(sms, 200, 8)
    start = drawn[:, stack.values(Poses.of(drawn), 0.05).min(axis=0) >= 0.015][:, 0]
    clear = 0
    for _ in range(100):
        goal = (start + rng.uniform(-turn, turn, sms.n))[:, None]
        inside = (goal[:, 0] > sms.limits.lower).all() and (goal[:, 0] < sms.limits.upper).all()
        if not inside or stack.values(Poses.of(goal), 0.05).min() < 0.015:
            continue
        q0 = sms.configuration(start)
        target = sms.at(sms.configuration(goal[:, 0])).end_effector_pose.translation
        plan = opt.plan(sms, q0, target, 12.0, 0.02)
        assert plan.clear, plan.note
        clear += 1
        h = 0.5 * plan.dt
        between = plan.joint_positions[:-1] + h * (plan.joint_rates[:-1] + 0.5 * h * plan.joint_accelerations)
        for row in np.concatenate([plan.joint_positions[::3], between[::3]]):
            assert not meshes.collide(sms.configuration(row))
        if clear == 2:
            return
    raise AssertionError("no goals were found")
