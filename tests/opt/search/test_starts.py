"""Initial motions of the search: joint goals, straight moves and rollouts."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from horizon_parts import moving_problem, node_rates, planar_problem, spline_of, trajectory_of

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.opt.search.inverse_kinematics import (
    halton,
    joint_goals,
    joint_range,
    spread_postures,
    straight_moves,
    straight_time,
)
from ffsms_pin.opt.step.stepwise import cheap_rollouts, sides_of, with_rest_at_end
from ffsms_pin.robot.base_motion import roll_out


def test_halton_points_agree_with_the_published_sequence() -> None:
    np.testing.assert_allclose(
        halton(0, 4, 2), [[1 / 2, 1 / 3], [1 / 4, 2 / 3], [3 / 4, 1 / 9], [1 / 8, 4 / 9]]
    )
    np.testing.assert_array_equal(halton(2, 2, 2), halton(0, 4, 2)[2:])


def test_seeds_are_spread_over_the_joint_ranges_or_near_the_start(planar: ffsms.SpaceManipulator) -> None:
    problem = planar_problem(planar)
    low, high = joint_range(problem)
    seeds, near = spread_postures(problem, 0, 32), spread_postures(problem, 0, 32, 0.3)
    assert (seeds >= low).all()
    assert (seeds <= high).all()
    assert (np.ptp(seeds, axis=0) > 0.8 * (high - low)).all()
    assert (np.abs(near - problem.joints0) <= 0.3).all()
    locked = planar_problem(planar, locked=["joint_2"])
    np.testing.assert_allclose(spread_postures(locked, 0, 8)[:, 1], problem.joints0[1], rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("with_attitude", [False, True])
def test_straight_moves_end_at_the_joint_goals(planar: ffsms.SpaceManipulator, with_attitude: bool) -> None:
    problem, tolerance = planar_problem(planar), 1e-3
    if with_attitude:
        # The end of a straight move of the floating robot is reachable.
        q, _ = roll_out(planar, problem.q0, np.array([0.5, -0.9, 0.8]), np.zeros((400, 3)), 1.0 / 400)
        problem = planar_problem(planar, goal=planar.at(q[-1]).end_effector_pose)
    place = problem.goal.place(6.0)
    goals = joint_goals(problem, spread_postures(problem, 0, 12))
    near = goals.distance < tolerance
    assert near.sum() >= (1 if with_attitude else 4)
    for joints in goals.joints[near]:
        move = joints - problem.joints0
        q, _ = roll_out(planar, problem.q0, move, np.zeros((400, 3)), 1.0 / 400)
        end = planar.at(q[-1]).end_effector_pose
        assert np.linalg.norm(end.translation - place.position) < 3e-3
        if place.rotation is not None:
            assert np.linalg.norm(pin.log3(place.rotation @ end.rotation.T)) < 3e-3
    spline = spline_of(problem)
    joints_only = planar_problem(planar, limits=[opt.JointLimits()])
    for p, goal in zip(straight_moves(problem, spline, goals.joints), goals.joints, strict=True):
        plan = trajectory_of(joints_only, node_rates(problem, spline, p))
        assert not plan.broken
        move, requested = plan.joint_positions[-1] - problem.joints0, goal - problem.joints0
        shares = move / requested  # below 1 for joints without enough time
        assert (shares > 0.0).all()
        assert (shares < 1.0 + 1e-3).all()


def test_straight_moves_begin_with_the_initial_rates(planar: ffsms.SpaceManipulator) -> None:
    problem = moving_problem(planar, limits=[opt.JointLimits()])
    spline = spline_of(problem)
    goals = problem.joints0 + np.array([[0.2, -0.1, 0.15], [-0.2, 0.1, -0.3]])
    for p, goal in zip(straight_moves(problem, spline, goals), goals, strict=True):
        rates = node_rates(problem, spline, p)
        np.testing.assert_allclose(rates[0], problem.joint_rates, rtol=0.0, atol=1e-14)
        plan = trajectory_of(problem, rates)
        np.testing.assert_allclose(plan.joint_positions[-1], goal, atol=2e-3)


def test_joint_goals_keep_locked_joints(planar: ffsms.SpaceManipulator) -> None:
    problem = planar_problem(planar, locked=["joint_1"])
    goals = joint_goals(problem, spread_postures(problem, 0, 8))
    np.testing.assert_array_equal(goals.joints[:, 0], np.full(8, problem.joints0[0]))


def test_joint_goals_respect_a_limit_on_the_final_base_attitude(planar: ffsms.SpaceManipulator) -> None:
    medians = {}
    for name, limits in (("free", []), ("held", [opt.BaseLimits(final_attitude=0.01)])):
        problem = planar_problem(planar, limits=[opt.JointLimits(), *limits])
        goals = joint_goals(problem, spread_postures(problem, 0, 12))
        turns = []
        for joints in goals.joints:
            q, _ = roll_out(planar, problem.q0, joints - problem.joints0, np.zeros((100, 3)), 0.01)
            start_rotation = planar.at(problem.q0).base_pose.rotation.T
            turns.append(np.linalg.norm(pin.log3(start_rotation @ planar.at(q[-1]).base_pose.rotation)))
        medians[name] = float(np.median(turns))
    assert medians["held"] < 0.8 * medians["free"]


def test_the_straight_time_is_set_by_the_slowest_joint(planar: ffsms.SpaceManipulator) -> None:
    problem, limits = planar_problem(planar), planar.limits
    displacement = np.array([0.0, 1.2, 0.1])
    expected = 1.2 / limits.velocity[1] + limits.velocity[1] / limits.acceleration[1]
    assert straight_time(problem, problem.joints0 + displacement) == pytest.approx(expected)
    short = 0.1 * limits.velocity[0] ** 2 / limits.acceleration[0]
    expected = 2.0 * np.sqrt(short / limits.acceleration[0])
    assert straight_time(problem, problem.joints0 + np.array([short, 0.0, 0.0])) == pytest.approx(expected)


def test_rollouts_keep_the_limits_and_stop_at_their_budget(planar: ffsms.SpaceManipulator) -> None:
    problem = planar_problem(planar, duration=12.0, dt=0.05)
    sides = sides_of(problem)
    rollouts = list(cheap_rollouts(problem, 10.0, sides))
    assert len(rollouts) == 2
    costs = []
    for rates in rollouts:
        plan = trajectory_of(problem, rates)
        assert not plan.broken, plan.note
        costs.append(plan.cost_integral)
    budget = 0.5 * sum(costs) if abs(costs[0] - costs[1]) > 1e-6 else 2.0 * max(costs)
    kept = list(cheap_rollouts(problem, budget, sides))
    assert len(kept) == sum(cost <= budget for cost in costs)
    assert list(cheap_rollouts(problem, -1.0, sides)) == []


def test_a_rollout_in_space_arrives_at_rest_at_low_cost() -> None:
    sms = ffsms.load("satellite_panda")
    q0 = sms.configuration(0.5 * (sms.limits.lower + sms.limits.upper))
    target = sms.at(q0).end_effector_pose.translation + np.array([-0.1, 0.2, 0.1])
    limits = [opt.JointLimits(), opt.Clearance(0.01, collision="points")]
    problem = opt.Problem(sms, q0, target, 12.0, 0.02, limits=limits)
    plan = trajectory_of(problem, next(cheap_rollouts(problem, 1e-3, sides_of(problem))))
    assert plan.reached, plan.note
    assert plan.cost_integral < 1e-3
    assert np.abs(plan.joint_rates[-1]).max() < 1e-3


def test_braking_to_rest_scales_all_joints_equally(planar: ffsms.SpaceManipulator) -> None:
    problem = planar_problem(planar, duration=2.0, dt=0.05)
    rates = np.tile([0.02, -0.01, 0.005], (problem.steps + 1, 1))
    slowed = with_rest_at_end(problem, rates)
    np.testing.assert_array_equal(slowed[0], rates[0])
    assert np.abs(slowed[-1]).max() < 1e-3
    np.testing.assert_allclose(slowed[:, 1:] / slowed[:, :1], rates[:, 1:] / rates[:, :1])
    braking = np.abs(np.diff(slowed[1:], axis=0)).max(axis=0) / problem.dt
    assert (braking <= planar.limits.acceleration).all()
