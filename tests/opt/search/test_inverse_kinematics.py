"""Inverse kinematics with a reacting base: ends of straight moves and their derivatives."""

from __future__ import annotations

import numpy as np
import pytest

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.geometry.bodies import BodyStack
from ffsms_pin.geometry.distances import Poses
from ffsms_pin.opt.search.diagnosis import keep_limits
from ffsms_pin.opt.search.gauss_newton import Model
from ffsms_pin.opt.search.inverse_kinematics import joint_goals, spread_postures, straight_ends
from ffsms_pin.opt.search.search import SearchOptions
from ffsms_pin.robot.base_motion import roll_out
from ffsms_pin.system.batch.stacks import apply, log3

START = np.array([0.0, 0.6, 0.0, 0.6, 0.0, 0.6, 0.0])
# Newton's method with J* alone converges from 1 of 24 postures to the end of this straight move.
GOAL = np.array([1.47, -1.89, 3.6, 0.55, -3.6, -2.93, -3.03])
STEPS = 200


def space_arm_problem(sms: ffsms.SpaceManipulator, with_attitude: bool = False) -> opt.Problem:
    """Return a problem to the end of a straight move that turns the base much."""
    q, _ = roll_out(sms, sms.configuration(START), GOAL - START, np.zeros((STEPS, 7)), 1.0 / STEPS)
    end = sms.at(q[-1]).end_effector_pose
    return opt.Problem(sms, sms.configuration(START), end if with_attitude else end.translation, 78.7, 0.1)


def test_the_base_rotation_of_a_straight_move_has_correct_derivatives() -> None:
    problem = space_arm_problem(ffsms.load("space_arm_7"))
    goals, h = np.random.default_rng(1).uniform(-1.5, 1.5, (4, 7)), 1e-5
    arm, R, integral_term = straight_ends(problem, goals, exact=True)
    assert integral_term is not None
    assert np.linalg.norm(log3(R), axis=0).max() > 0.8
    turning = apply(R, arm.spin) + integral_term
    for j in range(7):
        up, down = (straight_ends(problem, goals + side * np.eye(7)[j], exact=True)[1] for side in (h, -h))
        by_differences = log3(np.einsum("xyk,zyk->xzk", up, down)) / (2.0 * h)
        # Few Gauss points over a turn of a radian leave an error of a few per cent.
        np.testing.assert_allclose(turning[:, j], by_differences, atol=0.03 * np.abs(turning).max())
    assert np.abs(integral_term).max() > 0.2 * np.abs(turning).max()


def test_keep_limits_selects_collision_free_straight_moves() -> None:
    sms = ffsms.load("space_arm_7")
    problem = space_arm_problem(sms)
    goals = joint_goals(problem, spread_postures(problem, 0, 24)).joints
    model = Model.make(problem, SearchOptions().fine)
    good = keep_limits(model, goals)
    assert 0 < good.sum() < len(goals)
    stack = BodyStack(sms, "hulls", 0.01)
    for joints in goals[good]:
        positions = START[:, None] + (joints - START)[:, None] * np.linspace(0.0, 1.0, 101)
        assert stack.values(Poses.of(positions), 0.02).min() >= 0.01
    assert keep_limits(model, goals[:0]).shape == (0,)


@pytest.mark.parametrize(("with_attitude", "least"), [(False, 10), (True, 6)])
def test_joint_goals_of_a_heavy_arm_end_at_the_target(with_attitude: bool, least: int) -> None:
    sms = ffsms.load("space_arm_7")
    problem = space_arm_problem(sms, with_attitude)
    place, length = problem.goal.place(78.7).position, problem.stack.length
    solutions = joint_goals(problem, spread_postures(problem, 0, 24))
    converged = solutions.distance < 1e-3 * length
    assert converged.sum() >= least
    for joints in solutions.joints[converged]:
        q, _ = roll_out(sms, problem.q0, joints - START, np.zeros((STEPS, sms.n)), 1.0 / STEPS)
        end = sms.at(q[-1]).end_effector_pose.translation
        assert np.linalg.norm(end - place) < 0.03 * length
