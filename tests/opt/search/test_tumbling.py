"""Joint goals of straight moves while the whole robot tumbles."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.search.inverse_kinematics import (
    _tumbling_straight_ends,
    joint_goals,
    spread_postures,
    straight_moves,
)
from ffsms_pin.opt.search.spline import COARSE, RateSpline, rate_spline
from ffsms_pin.robot.base_motion import roll_out
from ffsms_pin.system.batch.stacks import apply, log3

START = np.array([0.2, 0.6, -0.3, 0.8, 0.1, 0.6, 0.0])
DURATION, STEPS = 120.0, 1200


def tumbling_problem(angle: float, joint_rates: FloatArray | None = None) -> opt.Problem:
    """Return a problem of the long arm on a satellite that turns by about `angle` [rad]."""
    sms = ffsms.load("space_arm_7")
    q0 = sms.configuration(START, pin.SE3(pin.exp3(np.array([0.3, -0.4, 0.2])), np.array([0.2, 0.1, -0.3])))
    problem = opt.Problem(sms, q0, [4.0, 3.0, 5.0], DURATION, 0.1)
    spin = angle / DURATION * np.array([0.48, -0.6, 0.64])
    momentum = problem.rotation0 @ np.linalg.solve(problem.arm0.inverse[..., 0], spin)
    momenta = np.concatenate([[20.0, -10.0, 5.0], momentum])
    return opt.Problem(sms, q0, [4.0, 3.0, 5.0], DURATION, 0.1, momentum=momenta, joint_rates=joint_rates)


def final_configuration(problem: opt.Problem, spline: RateSpline, p: FloatArray) -> FloatArray:
    """Return the configuration at the deadline (nq,) by a fine rollout."""
    nodes = np.linspace(0.0, DURATION, STEPS + 1)
    rates = spline.rates_at(nodes).of(p, problem.joint_rates)
    slopes = np.diff(rates, axis=0) * STEPS / DURATION
    q, _ = roll_out(problem.sms, problem.q0, rates[0], slopes, DURATION / STEPS, problem.momentum)
    return np.asarray(q[-1])


@pytest.mark.parametrize("moving", [False, True])
@pytest.mark.parametrize("angle", [0.5, 3.0])
def test_ends_of_straight_moves_agree_with_rollouts(angle: float, moving: bool) -> None:
    problem = tumbling_problem(angle, np.full(7, 0.01) if moving else None)
    spline = rate_spline(problem.steps, problem.dt, COARSE)
    goals = START + np.random.default_rng(1).uniform(-1.0, 1.0, (4, 7))
    arm, R, _ = _tumbling_straight_ends(problem, goals)
    for k, p in enumerate(straight_moves(problem, spline, goals)):
        q = final_configuration(problem, spline, p)
        np.testing.assert_allclose(arm.positions[:, k], q[7:], atol=1e-4)
        attitude = problem.rotation0.T @ pin.Quaternion(q[3:7]).toRotationMatrix()
        assert np.linalg.norm(pin.log3(R[..., k].T @ attitude)) < 0.02


@pytest.mark.parametrize("angle", [0.5, 3.0])
def test_derivatives_by_the_joint_goal(angle: float) -> None:
    problem, h = tumbling_problem(angle), 1e-5
    goals = START + np.random.default_rng(1).uniform(-1.0, 1.0, (4, 7))
    arm, R, path_turning = _tumbling_straight_ends(problem, goals)
    turning = apply(R, arm.spin) + path_turning
    for j in range(7):
        up, down = (_tumbling_straight_ends(problem, goals + side * np.eye(7)[j])[1] for side in (h, -h))
        by_differences = log3(np.einsum("xyk,zyk->xzk", up, down)) / (2.0 * h)
        # Two Gauss points on each interval leave an error of about 1 %.
        np.testing.assert_allclose(turning[:, j], by_differences, atol=0.02 * np.abs(turning).max())
    assert np.abs(path_turning).max() > 0.2 * np.abs(turning).max()


def test_rollouts_to_joint_goals_end_at_the_target() -> None:
    """Straight moves to converged goals end within 2 % of the arm's length of the target."""
    problem = tumbling_problem(2.0)
    spline = rate_spline(problem.steps, problem.dt, COARSE)
    solutions = joint_goals(problem, spread_postures(problem, 0, 24))
    arrived = solutions.arrived(problem)
    assert len(arrived) >= 6
    reachable_in_time = [goal for goal in arrived if np.abs(goal - START).max() < 5.0]  # [rad]
    assert reachable_in_time
    for p in straight_moves(problem, spline, np.array(reachable_in_time)):
        end = problem.sms.at(final_configuration(problem, spline, p)).end_effector_pose.translation
        assert np.linalg.norm(end - problem.place.position) < 0.02 * problem.stack.length
