"""Retreats from a client: straight, from any pose of the end effector."""

from __future__ import annotations

import re
from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.capture.retreat import moved_away, why_no_plan
from ffsms_pin.opt.plans import plan_problem
from ffsms_pin.opt.trajectory import measure

DURATION, RETREAT = 5.0, np.array([0.0, 0.0, -0.1])


def _problem(*obstacles: opt.Obstacle, locked: tuple[str, ...] = (), spin_factor: float = 1.0) -> opt.Problem:
    """Return a problem: an end effector 20 mm beside its grasp, moving with a client that turns."""
    sms = ffsms.load("satellite_panda")
    q = sms.configuration([0.3, -0.6, 0.2, -1.9, 0.4, 1.5, 0.8])
    grasp = pin.SE3(pin.exp3(np.array([0.1, 0.2, 0.3])), np.array([0.0, 0.0, -0.6]))
    beside = pin.SE3(np.eye(3), np.array([0.02, 0.0, 0.0]))
    tip = sms.at(q).end_effector_pose
    pose = tip * (grasp * beside).inverse()
    spin = spin_factor * np.array([0.004, -0.008, 0.006])
    client = ffsms.Client(80.0, [6.0, 9.0, 11.0], pose, np.append([0.002, 0.0, 0.001], spin))
    tip_twist = np.append(
        client.twist(0.0)[:3] + np.cross(client.twist(0.0)[3:], tip.translation - pose.translation),
        client.twist(0.0)[3:],
    )
    free = np.array([name not in locked for name in sms.joint_names])
    rates = np.linalg.pinv(sms.at(q).J_star * free) @ tip_twist
    limits = [opt.JointLimits(), opt.Clearance(0.01, obstacles=obstacles)]
    goal = opt.Meet(client, grasp, misalignment=0.3)
    return opt.Problem(sms, q, goal, DURATION, 0.05, limits=limits, joint_rates=rates, locked=locked)


def _displacements(problem: opt.Problem, plan: opt.Trajectory) -> np.ndarray:
    """Return displacements relative to the client (N + 1, 3), grasp axes; check the relative rotation."""
    goal = problem.goal
    assert isinstance(goal, opt.Meet)
    poses = [
        (goal.client.pose(t) * goal.grasp).actInv(problem.sms.at(q).end_effector_pose)
        for t, q in zip(plan.t, plan.q, strict=True)
    ]
    assert max(np.linalg.norm(pin.log3(pose.rotation)) for pose in poses) < 1e-2
    return np.array([pose.translation - poses[0].translation for pose in poses])


def _final_displacement(problem: opt.Problem, plan: opt.Trajectory) -> np.ndarray:
    """Return the final displacement relative to the client (3,), grasp axes."""
    goal = problem.goal
    assert isinstance(goal, opt.Meet)
    ends = (0.0, problem.q0), (plan.duration, plan.q[-1])
    first, last = (
        (goal.client.pose(t) * goal.grasp).actInv(problem.sms.at(q).end_effector_pose).translation
        for t, q in ends
    )
    return np.asarray(last - first)


def test_a_retreat_is_straight_and_turns_with_the_client() -> None:
    problem = _problem()
    plan, reason = moved_away(problem, RETREAT)
    assert plan is not None, reason
    displacements = _displacements(problem, plan)
    np.testing.assert_allclose(displacements[-1], RETREAT, atol=2e-3)
    assert np.abs(displacements[:, :2]).max() < 2e-3
    assert (np.diff(displacements[:, 2]) < 1e-4).all()
    assert not plan.broken
    np.testing.assert_array_equal(plan.joint_rates[0], problem.joint_rates)


def test_a_clearance_violated_at_the_start_does_not_get_worse() -> None:
    """A wall beside the hand is nearer than the required clearance, so a planner refuses the start."""
    free = _problem()
    hand = free.sms.at(free.q0).end_effector_pose
    wall = pin.SE3(hand.rotation, hand.act(np.array([0.0, 0.0, 0.02])))
    near = opt.Obstacle(coal.Box(0.3, 0.3, 0.01), wall, name="wall")
    problem = _problem(near)
    assert not plan_problem(problem).clear
    plan, _ = moved_away(problem, RETREAT)
    assert plan is not None
    np.testing.assert_allclose(_displacements(problem, plan)[-1], RETREAT, atol=2e-3)
    assert 0.0 < plan.broken["clearance"] < 0.01


@pytest.mark.long
@pytest.mark.slow
def test_a_wall_blocks_a_retreat() -> None:
    free, away = _problem(), np.array([0.0, 0.0, 0.1])
    assert moved_away(free, away)[0] is not None
    hand = free.sms.at(free.q0).end_effector_pose
    wall = pin.SE3(hand.rotation, hand.act(np.array([0.0, 0.0, 0.08])))
    problem = _problem(opt.Obstacle(coal.Box(0.3, 0.3, 0.01), wall, name="wall"))
    plan, reason = moved_away(problem, away)
    assert plan is None
    assert "wall" in reason


@pytest.mark.parametrize("spin_factor", [8.0, 16.0])
def test_the_gripper_turns_less_and_less_with_a_fast_client(
    spin_factor: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At 5 and 10 deg/s the retreat is straight and fast, and the gripper's rotation rate is ramped down."""
    problem, displacement = replace(_problem(spin_factor=spin_factor), duration=10.0), 3.0 * RETREAT
    plan, reason = moved_away(problem, displacement)
    assert plan is not None, reason
    assert not plan.broken
    assert plan.duration < 10.0 or spin_factor > 10.0
    np.testing.assert_allclose(_final_displacement(problem, plan), displacement, atol=0.015)
    monkeypatch.setattr("ffsms_pin.capture.retreat._TURNING", [(1.0, 0)])
    monkeypatch.setattr("ffsms_pin.capture.retreat.plan_problem", plan_without_motion)
    plan, reason = moved_away(problem, displacement)
    assert plan is None
    assert "a straight motion violates limits (joints" in reason


def test_the_reason_of_a_failed_plan_follows_from_its_motion() -> None:
    """The arm stays at its start: near a wall, out of the reach of the grasp, or 20 mm beside it."""
    free = _problem()
    hand = free.sms.at(free.q0).end_effector_pose
    wall = pin.SE3(hand.rotation, hand.act(np.array([0.0, 0.0, 0.02])))
    near = _problem(opt.Obstacle(coal.Box(0.3, 0.3, 0.01), wall, name="wall"))
    goal = free.goal
    assert isinstance(goal, opt.Meet)
    out_of_reach = replace(
        free, goal=replace(goal, grasp=goal.grasp * pin.SE3(np.eye(3), np.array([0.0, 0.0, 9.0])))
    )
    still = np.zeros((free.steps + 1, free.sms.n))
    assert re.search(r"keeps clear of obstacles \(blocked by .*wall", why_no_plan(measure(near, still)))
    assert re.search(
        r"out of the workspace at the deadline, \d\.\d+ m away", why_no_plan(measure(out_of_reach, still))
    )
    assert re.search(r"ends \d+(\.\d)? mm and \d.* deg from the grasp", why_no_plan(measure(free, still)))


def plan_without_motion(problem: opt.Problem) -> opt.Trajectory:
    return replace(measure(problem, np.zeros((problem.steps + 1, problem.sms.n))), note="nothing found")


def test_a_relative_velocity_at_the_start_is_stopped_gently() -> None:
    problem = _problem(spin_factor=4.0)
    still = replace(problem, joint_rates=0.0 * problem.joint_rates, duration=10.0)
    plan, reason = moved_away(still, RETREAT)
    assert plan is not None, reason
    first = np.abs(plan.joint_accelerations[:10]) / problem.sms.limits.acceleration
    assert first.max() < 0.5


def test_the_first_feasible_of_two_retreats_is_planned() -> None:
    problem = replace(_problem(), duration=10.0)
    for displacements, distance in (((3.0 * RETREAT, RETREAT), 0.3), ((30.0 * RETREAT, RETREAT), 0.1)):
        plan, reason = moved_away(problem, *displacements)
        assert plan is not None, reason
        assert np.linalg.norm(_final_displacement(problem, plan)) == pytest.approx(distance, abs=5e-3)


def test_locked_joints_stay_at_rest() -> None:
    problem = _problem(locked=("panda_joint3",))
    plan, reason = moved_away(problem, RETREAT)
    assert plan is not None, reason
    np.testing.assert_array_equal(plan.joint_rates[1:, 2], 0.0)
    with pytest.raises(AssertionError):
        moved_away(opt.Problem(problem.sms, problem.q0, [1.0, 0.0, 0.0]), RETREAT)
