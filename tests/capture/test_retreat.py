"""The way back from a client: straight, from wherever the end effector is."""

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

DURATION, WAY = 5.0, np.array([0.0, 0.0, -0.1])


def _problem(*obstacles: opt.Obstacle, locked: tuple[str, ...] = (), faster: float = 1.0) -> opt.Problem:
    """An end effector 20 mm beside its grasp on a client that turns, moving as the client does."""
    sms = ffsms.load("satellite_panda")
    q = sms.configuration([0.3, -0.6, 0.2, -1.9, 0.4, 1.5, 0.8])
    grasp = pin.SE3(pin.exp3(np.array([0.1, 0.2, 0.3])), np.array([0.0, 0.0, -0.6]))
    beside = pin.SE3(np.eye(3), np.array([0.02, 0.0, 0.0]))
    tip = sms.at(q).end_effector_pose
    pose = tip * (grasp * beside).inverse()
    spin = faster * np.array([0.004, -0.008, 0.006])
    client = ffsms.Client(80.0, [6.0, 9.0, 11.0], pose, np.append([0.002, 0.0, 0.001], spin))
    there = np.append(
        client.twist(0.0)[:3] + np.cross(client.twist(0.0)[3:], tip.translation - pose.translation),
        client.twist(0.0)[3:],
    )
    free = np.array([name not in locked for name in sms.joint_names])
    rates = np.linalg.pinv(sms.at(q).J_star * free) @ there
    limits = [opt.JointLimits(), opt.Clearance(0.01, obstacles=obstacles)]
    goal = opt.Meet(client, grasp, misalignment=0.3)
    return opt.Problem(sms, q, goal, DURATION, 0.05, limits=limits, joint_rates=rates, locked=locked)


def _away(problem: opt.Problem, plan: opt.Trajectory) -> np.ndarray:
    """The way gone, as the client sees it, grasp axes (N + 1, 3), and the largest turn against it [rad]."""
    goal = problem.goal
    assert isinstance(goal, opt.Meet)
    seen = [
        (goal.client.pose(t) * goal.grasp).actInv(problem.sms.at(q).end_effector_pose)
        for t, q in zip(plan.t, plan.q, strict=True)
    ]
    assert max(np.linalg.norm(pin.log3(one.rotation)) for one in seen) < 1e-2
    return np.array([one.translation - seen[0].translation for one in seen])


def _gone(problem: opt.Problem, plan: opt.Trajectory) -> np.ndarray:
    """The way gone in the end (3,), as the client sees it, grasp axes."""
    goal = problem.goal
    assert isinstance(goal, opt.Meet)
    ends = (0.0, problem.q0), (plan.duration, plan.q[-1])
    first, last = (
        (goal.client.pose(t) * goal.grasp).actInv(problem.sms.at(q).end_effector_pose).translation
        for t, q in ends
    )
    return np.asarray(last - first)


def test_it_is_straight_and_turns_with_the_client() -> None:
    problem = _problem()
    plan, trouble = moved_away(problem, WAY)
    assert plan is not None, trouble
    way = _away(problem, plan)
    np.testing.assert_allclose(way[-1], WAY, atol=2e-3)
    assert np.abs(way[:, :2]).max() < 2e-3
    assert (np.diff(way[:, 2]) < 1e-4).all()
    assert not plan.broken
    np.testing.assert_array_equal(plan.joint_rates[0], problem.joint_rates)


def test_a_clearance_that_is_broken_at_the_start_only_does_not_get_worse() -> None:
    """A wall beside the hand, nearer than is asked for: a planner refuses the start."""
    free = _problem()
    hand = free.sms.at(free.q0).end_effector_pose
    wall = pin.SE3(hand.rotation, hand.act(np.array([0.0, 0.0, 0.02])))
    near = opt.Obstacle(coal.Box(0.3, 0.3, 0.01), wall, name="wall")
    problem = _problem(near)
    assert not plan_problem(problem).clear
    plan, _ = moved_away(problem, WAY)
    assert plan is not None
    np.testing.assert_allclose(_away(problem, plan)[-1], WAY, atol=2e-3)
    assert 0.0 < plan.broken["clearance"] < 0.01


@pytest.mark.long
@pytest.mark.slow
def test_a_wall_in_the_way_is_not_gone_through() -> None:
    free, away = _problem(), np.array([0.0, 0.0, 0.1])
    assert moved_away(free, away)[0] is not None
    hand = free.sms.at(free.q0).end_effector_pose
    wall = pin.SE3(hand.rotation, hand.act(np.array([0.0, 0.0, 0.08])))
    problem = _problem(opt.Obstacle(coal.Box(0.3, 0.3, 0.01), wall, name="wall"))
    plan, trouble = moved_away(problem, away)
    assert plan is None
    assert "wall" in trouble


@pytest.mark.parametrize("faster", [8.0, 16.0])
def test_a_client_that_turns_fast_is_not_followed_all_the_way(
    faster: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At 5 and 10 deg/s: out of it straight and quickly, while the hand turns less and less with it."""
    problem, way = replace(_problem(faster=faster), duration=10.0), 3.0 * WAY
    plan, trouble = moved_away(problem, way)
    assert plan is not None, trouble
    assert not plan.broken
    assert plan.duration < 10.0 or faster > 10.0
    np.testing.assert_allclose(_gone(problem, plan), way, atol=0.015)
    monkeypatch.setattr("ffsms_pin.capture.retreat._TURNING", [(1.0, 0)])
    monkeypatch.setattr("ffsms_pin.capture.retreat.plan_problem", plan_problem_that_finds_nothing)
    plan, trouble = moved_away(problem, way)
    assert plan is None
    assert "a straight motion violates limits (joints" in trouble


def test_the_reason_of_a_failed_plan_follows_from_its_motion() -> None:
    """The motion stays at the start, near a wall, 20 mm beside the grasp, or out of the client's reach."""
    free = _problem()
    hand = free.sms.at(free.q0).end_effector_pose
    wall = pin.SE3(hand.rotation, hand.act(np.array([0.0, 0.0, 0.02])))
    near = _problem(opt.Obstacle(coal.Box(0.3, 0.3, 0.01), wall, name="wall"))
    goal = free.goal
    assert isinstance(goal, opt.Meet)
    apart = replace(
        free, goal=replace(goal, grasp=goal.grasp * pin.SE3(np.eye(3), np.array([0.0, 0.0, 9.0])))
    )
    still = np.zeros((free.steps + 1, free.sms.n))
    assert re.search(r"keeps clear of obstacles \(blocked by .*wall", why_no_plan(measure(near, still)))
    assert re.search(
        r"out of the workspace at the deadline, \d\.\d+ m away", why_no_plan(measure(apart, still))
    )
    assert re.search(r"ends \d+(\.\d)? mm and \d.* deg from the grasp", why_no_plan(measure(free, still)))


def plan_problem_that_finds_nothing(problem: opt.Problem) -> opt.Trajectory:
    return replace(measure(problem, np.zeros((problem.steps + 1, problem.sms.n))), note="nothing found")


def test_what_moves_past_the_client_at_first_is_stopped_gently() -> None:
    problem = _problem(faster=4.0)
    still = replace(problem, joint_rates=0.0 * problem.joint_rates, duration=10.0)
    plan, trouble = moved_away(still, WAY)
    assert plan is not None, trouble
    first = np.abs(plan.joint_accelerations[:10]) / problem.sms.limits.acceleration
    assert first.max() < 0.5


def test_of_two_ways_the_first_that_can_be_is_gone() -> None:
    problem = replace(_problem(), duration=10.0)
    for ways, gone in (((3.0 * WAY, WAY), 0.3), ((30.0 * WAY, WAY), 0.1)):
        plan, trouble = moved_away(problem, *ways)
        assert plan is not None, trouble
        assert np.linalg.norm(_gone(problem, plan)) == pytest.approx(gone, abs=5e-3)


def test_locked_joints_stay() -> None:
    problem = _problem(locked=("panda_joint3",))
    plan, trouble = moved_away(problem, WAY)
    assert plan is not None, trouble
    np.testing.assert_array_equal(plan.joint_rates[1:, 2], 0.0)
    with pytest.raises(AssertionError):
        moved_away(opt.Problem(problem.sms, problem.q0, [1.0, 0.0, 0.0]), WAY)
