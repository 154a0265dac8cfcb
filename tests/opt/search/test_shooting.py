"""Shooting for joint goals: where straight moves end, and what moves that end."""

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
# Newton's method through J* alone finds one joint goal of 24 for where this one's straight move ends.
GOAL = np.array([1.47, -1.89, 3.6, 0.55, -3.6, -2.93, -3.03])
STEPS = 200


def space_arm_problem(sms: ffsms.SpaceManipulator, posed: bool = False) -> opt.Problem:
    """To where a straight move ends that turns the base much: the arm weighs more than a tenth of it."""
    q, _ = roll_out(sms, sms.configuration(START), GOAL - START, np.zeros((STEPS, 7)), 1.0 / STEPS)
    end = sms.at(q[-1]).end_effector_pose
    return opt.Problem(sms, sms.configuration(START), end if posed else end.translation, 78.7, 0.1)


def test_a_changed_goal_turns_the_base_along_the_whole_move() -> None:
    problem = space_arm_problem(ffsms.load("space_arm_7"))
    goals, h = np.random.default_rng(1).uniform(-1.5, 1.5, (4, 7)), 1e-5
    arm, R, beyond = straight_ends(problem, goals, exact=True)
    assert beyond is not None
    assert np.linalg.norm(log3(R), axis=0).max() > 0.8
    turning = apply(R, arm.spin) + beyond
    for j in range(7):
        up, down = (straight_ends(problem, goals + side * np.eye(7)[j], exact=True)[1] for side in (h, -h))
        by_differences = log3(np.einsum("xyk,zyk->xzk", up, down)) / (2.0 * h)
        # Gauss points that are few against a turn of a radian leave a few per cent.
        np.testing.assert_allclose(turning[:, j], by_differences, atol=0.03 * np.abs(turning).max())
    assert np.abs(beyond).max() > 0.2 * np.abs(turning).max()


def test_straight_moves_that_keep_the_limits_are_told_from_the_others() -> None:
    sms = ffsms.load("space_arm_7")
    problem = space_arm_problem(sms)
    goals = joint_goals(problem, spread_postures(problem, 0, 24)).joints
    model = Model.make(problem, SearchOptions().fine)
    good = keep_limits(model, goals)
    assert 0 < good.sum() < len(goals)
    stack = BodyStack(sms, "hulls", 0.01)
    for joints in goals[good]:
        way = START[:, None] + (joints - START)[:, None] * np.linspace(0.0, 1.0, 101)
        assert stack.values(Poses.of(way), 0.02).min() >= 0.01
    assert keep_limits(model, goals[:0]).shape == (0,)


@pytest.mark.parametrize(("posed", "least"), [(False, 10), (True, 6)])
def test_joint_goals_of_an_arm_that_turns_its_base_much(posed: bool, least: int) -> None:
    sms = ffsms.load("space_arm_7")
    problem = space_arm_problem(sms, posed)
    place, length = problem.goal.place(78.7).position, problem.stack.length
    found = joint_goals(problem, spread_postures(problem, 0, 24))
    there = found.distance < 1e-3 * length
    assert there.sum() >= least
    for joints in found.joints[there]:
        q, _ = roll_out(sms, problem.q0, joints - START, np.zeros((STEPS, sms.n)), 1.0 / STEPS)
        end = sms.at(q[-1]).end_effector_pose.translation
        assert np.linalg.norm(end - place) < 0.03 * length
