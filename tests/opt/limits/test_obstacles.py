"""Obstacles, inertial, on a client and on the base; plans with and without them are checked by coal."""

from __future__ import annotations

import pickle
from dataclasses import replace
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
from by_coal import GOAL, START, ByCoal
from clearances_at import least_clearance

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.geometry.distances import Least
from ffsms_pin.opt.limits import clearance
from ffsms_pin.opt.trajectory import measure


def middle_pose(plan: opt.Trajectory) -> pin.SE3:
    """Return the end effector's position in the middle of a plan, as a pose."""
    return pin.SE3(np.eye(3), plan.end_effector[len(plan.end_effector) // 2])


@pytest.fixture(scope="module")
def free(planar: ffsms.SpaceManipulator) -> opt.Trajectory:
    return opt.plan(planar, planar.configuration(START), GOAL, duration=8.0, dt=0.02)


@pytest.mark.parametrize(
    "shape", [coal.Sphere(0.06), coal.Box(0.1, 0.08, 0.1), coal.Cylinder(0.05, 0.2), coal.Capsule(0.04, 0.1)]
)
def test_plans_with_and_without_an_obstacle(
    planar: ffsms.SpaceManipulator, free: opt.Trajectory, shape: Any
) -> None:
    pose, by_coal = middle_pose(free), ByCoal(planar)
    assert min(by_coal(q, shape, pose) for q in free.q) < 0.0
    obstacle = opt.Obstacle(shape, pose, margin=0.005)
    plan = opt.plan(planar, free.q[0], GOAL, duration=8.0, dt=0.02, obstacles=[obstacle])
    assert plan.reached, plan.note
    assert min(by_coal(q, shape, pose) for q in plan.q) >= 0.015 - 2e-5


def test_a_spatial_arm_avoids_a_sphere() -> None:
    sms = ffsms.load("satellite_panda")
    low, high = (np.clip(bound, -2.0, 2.0) for bound in (sms.limits.lower, sms.limits.upper))
    q0 = sms.configuration(0.5 * (low + high))
    target = sms.at(q0).end_effector_pose.translation + np.array([-0.1, 0.45, 0.05])
    free = opt.plan(sms, q0, target, duration=10.0, dt=0.05)
    shape, by_coal = coal.Sphere(0.07), ByCoal(sms)
    pose = middle_pose(free)
    assert free.reached
    assert min(by_coal(q, shape, pose) for q in free.q) < 0.0
    obstacles = [opt.Obstacle(shape, pose)]
    plan = opt.plan(sms, q0, target, duration=10.0, dt=0.05, obstacles=obstacles)
    assert plan.reached, plan.note
    assert min(by_coal(q, shape, pose) for q in plan.q) >= 0.01 - 2e-5


def test_the_least_distance_agrees_with_coal(rng: np.random.Generator) -> None:
    """All shapes of this arm are convex, so no shape is decomposed."""
    sms = ffsms.load("space_arm_7")
    by_coal, pose = ByCoal(sms), pin.SE3(pin.exp3(np.array([0.3, 0.4, -0.5])), np.array([1.5, 2.0, 1.0]))
    box = opt.Obstacle(coal.Box(0.4, 0.5, 0.6), pose, margin=0.02)
    limit = opt.Clearance(0.0, "off", obstacles=[box]).for_robot(sms)
    q0 = sms.configuration(rng.uniform(-1.0, 1.0, sms.n))
    problem = opt.Problem(sms, q0, sms.at(q0).end_effector_pose.translation, 4.0, 0.5, limits=[limit])
    rates = 0.2 * rng.normal(size=(9, sms.n))
    motion = motion_of(problem, rates)
    least, pair = least_clearance(limit, motion)
    plan = measure(problem, rates)
    nodes = min(by_coal(q, box.shape, pose) for q in plan.q) - 0.02
    assert least <= nodes + 1e-6
    assert least == pytest.approx(nodes, abs=0.05)
    assert pair.endswith(" - box 1")


def motion_of(problem: opt.Problem, rates: FloatArray) -> opt.Rollouts:
    from ffsms_pin.opt.rollouts import rolled_out

    return rolled_out(problem.sms, problem.stack, problem.q0, rates, problem.dt, problem.momentum)


def test_a_violation_between_instants_is_detected(planar: ffsms.SpaceManipulator) -> None:
    """The arm sweeps past a small sphere after a quarter of a step and is clear of it at all instants."""
    q0, dt = planar.configuration(START), 0.8
    rates = np.full((2, 3), 0.0)
    rates[:, 0] = 0.7
    problem = opt.Problem(planar, q0, GOAL, dt, dt, limits=[])
    motion = motion_of(problem, rates)
    # The sphere is at the end effector after a quarter of the step.
    plan = measure(opt.Problem(planar, q0, GOAL, dt, dt / 8, limits=[]), np.tile(rates[:1], (9, 1)))
    at, shape = pin.SE3(np.eye(3), plan.end_effector[2]), coal.Sphere(0.004)
    by_coal = ByCoal(planar)
    instants = [by_coal(plan.q[k], shape, at) for k in (0, 4, 8)]
    assert min(instants) > 0.012
    assert by_coal(plan.q[2], shape, at) < 0.005
    limit = opt.Clearance(0.01, "off", obstacles=[opt.Obstacle(shape, at)]).for_robot(planar)
    assert least_clearance(limit, motion)[0] > 0.01
    violation = limit.violation(motion)
    assert violation.amount > 0.004
    assert "sphere 1" in violation.note


def test_an_obstacle_on_the_base(planar: ffsms.SpaceManipulator, free: opt.Trajectory) -> None:
    """The panel is on the free plan in base axes; pairs with the base itself are left out."""
    k = len(free.q) // 2
    base = [pin.XYZQUATToSE3(q[:7]) for q in free.q]
    place = base[k].actInv(middle_pose(free))
    panel = opt.Obstacle(coal.Box(0.08, 0.08, 0.08), place, "base", name="panel")
    reaches_base = opt.Obstacle(coal.Box(0.1, 0.1, 0.1), pin.SE3.Identity(), "base")
    limit = opt.Clearance(0.01, "off", obstacles=[panel, reaches_base]).for_robot(planar)
    assert sum("panel" in name for name in limit._stacks[0].names) == 3
    plan = opt.plan(planar, free.q[0], GOAL, duration=8.0, dt=0.02, obstacles=[panel])
    assert plan.reached, plan.note
    by_coal = ByCoal(planar)
    poses = [pin.XYZQUATToSE3(q[:7]) * place for q in plan.q]
    links = [2, 3, 4]
    assert min(by_coal(q, panel.shape, p, links) for q, p in zip(plan.q, poses, strict=True)) >= 0.01 - 2e-5
    poses = [b * place for b in base]
    assert min(by_coal(q, panel.shape, p, links) for q, p in zip(free.q, poses, strict=True)) < 0.0


def test_an_obstacle_on_a_client(planar: ffsms.SpaceManipulator, free: opt.Trajectory) -> None:
    """A tumbling client crosses the free plan at half time; a motion that starts later is clear of it."""
    half, by_coal, shape = free.t[len(free.t) // 2], ByCoal(planar), coal.Box(0.06, 0.06, 0.06)
    velocity = np.array([0.0, 0.0, 0.1])
    start = pin.SE3(np.eye(3), middle_pose(free).translation - half * velocity)
    client = ffsms.Client(
        50.0, np.diag([3.0, 4.0, 5.0]), pose=start, twist=np.concatenate([velocity, [0.05, 0.02, 0.1]])
    )
    obstacle = opt.Obstacle(shape, pin.SE3.Identity(), client)
    problem = opt.Problem(
        planar, free.q[0], GOAL, 8.0, 0.02, limits=[opt.JointLimits(), opt.Clearance(obstacles=[obstacle])]
    )
    assert "clearance" in measure(problem, free.joint_rates).broken
    plan = opt.solve(problem)
    assert plan.reached, plan.note
    near = [by_coal(q, shape, client.pose(t)) for q, t in zip(plan.q, plan.t, strict=True)]
    assert min(near) >= 0.01 - 2e-5
    # With an offset of 6 s the client has passed.
    assert "clearance" not in measure(replace(problem, time_offset=6.0), free.joint_rates).broken


def test_a_grasped_payload_is_kept_clear(planar: ffsms.SpaceManipulator, free: opt.Trajectory) -> None:
    """The obstacle is beside the free plan, where the payload alone touches it."""
    box, grasped = coal.Box(0.05, 0.05, 0.05), (coal.Box(0.04, 0.04, 0.3), pin.SE3.Identity())
    place = pin.SE3(np.eye(3), middle_pose(free).translation + np.array([0.0, 0.0, 0.15]))
    obstacle = opt.Obstacle(box, place)
    plain = opt.Clearance(obstacles=[obstacle])
    loaded = opt.Clearance(obstacles=[obstacle], payload=grasped)

    def problem(limit: opt.Limit) -> opt.Problem:
        return opt.Problem(planar, free.q[0], GOAL, 8.0, 0.02, limits=[opt.JointLimits(), limit])

    assert measure(problem(plain), free.joint_rates).broken == {}
    broken = measure(problem(loaded), free.joint_rates)
    assert "payload - box 1" in broken.note
    plan = opt.solve(problem(loaded))
    assert plan.reached, plan.note
    result = coal.DistanceResult()
    for q in plan.q[::5]:
        pose = planar.at(q).end_effector_pose
        here = coal.Transform3s(pose.rotation, pose.translation)
        there = coal.Transform3s(np.eye(3), place.translation)
        result.clear()
        assert coal.distance(grasped[0], here, box, there, coal.DistanceRequest(), result) >= 0.01 - 2e-5


def test_points_mode_detects_an_obstacle_between_joints(planar: ffsms.SpaceManipulator) -> None:
    """A ball on the line between two joints, far from both."""
    q = planar.configuration(START)
    data = planar.model.createData()
    pin.forwardKinematics(planar.model, data, q)
    between = 0.5 * (data.oMi[3].translation + data.oMi[4].translation)
    limit = opt.Clearance(
        0.01, "points", obstacles=[opt.Obstacle(coal.Sphere(0.01), pin.SE3(np.eye(3), between))]
    )
    still = opt.Problem(planar, q, GOAL).motion(np.zeros((2, 3)))
    assert limit.for_robot(planar).violation(still).overlap.endswith("sphere 1 overlap by 10.0 mm")


def test_an_unproven_clearance_is_not_reported_as_an_overlap(
    planar: ffsms.SpaceManipulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    still = opt.Problem(planar, planar.configuration(START), GOAL).motion(np.zeros((2, 3)))
    least = Least(-0.05, 0, 1.0, np.empty(0), exact=False)
    monkeypatch.setattr(clearance, "least_of", lambda *_: least)
    violation = opt.Clearance(0.01, "points").for_robot(planar).violation(still)
    assert violation.overlap == ""
    assert violation.note.startswith("a clearance is not proven")
    assert "come no nearer than -50.0 mm" in violation.nearest


@pytest.mark.slow
def test_a_blocked_plan_names_the_pair(planar: ffsms.SpaceManipulator) -> None:
    q0 = planar.configuration(START)
    target = np.array([0.45, 0.75, 0.0])
    walls = [
        opt.Obstacle(
            coal.Box(0.3, 0.02, 0.4), pin.SE3(np.eye(3), target + np.array([0.0, side, 0.0])), name=name
        )
        for side, name in ((0.045, "upper wall"), (-0.045, "lower wall"))
    ]
    back = pin.SE3(np.eye(3), target + np.array([0.045, 0.0, 0.0]))
    front = pin.SE3(np.eye(3), target - np.array([0.045, 0.0, 0.0]))
    walls += [opt.Obstacle(coal.Box(0.02, 0.3, 0.4), place) for place in (back, front)]
    plan = opt.plan(planar, q0, target, duration=8.0, dt=0.02, obstacles=walls)
    assert not plan.reached
    assert "blocked by link_3 - " in plan.note or "violated: link_3 - " in plan.note, plan.note


def test_step_plans_and_pickled_limits_keep_clear(
    planar: ffsms.SpaceManipulator, free: opt.Trajectory
) -> None:
    """A plan by steps keeps clear of an obstacle; a pickled limit gives the same violation."""
    obstacle = opt.Obstacle(coal.Sphere(0.05), middle_pose(free))
    options: dict[str, Any] = {"duration": 8.0, "dt": 0.02, "obstacles": [obstacle], "method": "step"}
    plan = opt.plan(planar, free.q[0], GOAL, **options)
    assert plan.clear, plan.note
    limit = opt.Clearance(obstacles=[obstacle]).for_robot(planar)
    copy = pickle.loads(pickle.dumps(limit))
    motion = motion_of(opt.Problem(planar, free.q[0], GOAL, 8.0, 0.02), free.joint_rates)
    assert copy.violation(motion).amount == limit.violation(motion).amount > 0.0
