"""Initial moves of a search for a motion to a client."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.opt.search.gauss_newton import Model
from ffsms_pin.opt.search.inverse_kinematics import joint_goals, moves_to
from ffsms_pin.opt.search.search import SearchOptions
from ffsms_pin.opt.trajectory import measure

DURATION = 20.0


@pytest.fixture(scope="module")
def problem() -> opt.Problem:
    """A problem with a tumbling client whose grasp is within reach."""
    sms = ffsms.load("satellite_panda")
    q0 = sms.configuration([0.0, -0.5, 0.0, -2.0, 0.0, 1.5, 0.8])
    grasp = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.3]))
    there = sms.at(q0).end_effector_pose * pin.SE3(np.eye(3), np.array([0.1, 0.15, 0.25]))
    then = ffsms.Client(80.0, [6.0, 9.0, 11.0], there * grasp.inverse(), [0.0, 0.0, 0.0, 0.02, -0.03, 0.02])
    now = ffsms.Client(80.0, [6.0, 9.0, 11.0], then.pose(-DURATION), then.twist(-DURATION))
    return opt.Problem(sms, q0, opt.Meet(now, grasp), DURATION, 0.05)


def _start(problem: opt.Problem) -> opt.Trajectory:
    goals = joint_goals(problem, problem.joints0[None])
    assert goals.distance[0] < 1e-3
    spline = Model.make(problem, SearchOptions().fine).spline
    p = moves_to(problem, spline, goals.joints)
    nodes = np.linspace(0.0, problem.duration, problem.steps + 1)
    return measure(problem, spline.rates_at(nodes).of(p[0], problem.joint_rates))


def test_the_approach_leads_along_the_axis_from_the_mouth_to_the_grasp(problem: opt.Problem) -> None:
    goal = problem.goal
    approach = goal.approach(DURATION)
    times = [t for t, _ in approach]
    assert times == sorted(times)
    assert times[-1] < DURATION
    distances = []
    for t, place in approach:
        x = (goal.client.pose(t) * goal.grasp).actInv(place.position)
        np.testing.assert_allclose(np.cross(x, goal.axis), np.zeros(3), atol=1e-12)
        distances.append(-float(x @ goal.axis))
    assert distances[0] == pytest.approx(goal.standoff)
    assert distances == sorted(distances, reverse=True)
    # In the last tenth the approach is at the grasp.
    late = [distance for t, distance in zip(times, distances, strict=True) if t >= 0.9 * DURATION]
    assert late
    np.testing.assert_allclose(late, 0.0, atol=1e-12)
    assert replace(goal, standoff=0.0).approach(DURATION) == []


def test_the_approach_ends_at_the_deadline_if_the_reach_is_wide(problem: opt.Problem) -> None:
    goal = replace(problem.goal, reach=0.4 * problem.goal.standoff)
    for t, place in goal.approach(DURATION):
        remaining = np.linalg.norm(place.position - (goal.client.pose(t) * goal.grasp).translation)
        assert remaining > 0.0
        assert remaining < 0.5 * goal.reach or t < 0.9 * DURATION


def test_an_initial_move_passes_the_positions_of_the_approach(problem: opt.Problem) -> None:
    plan = _start(problem)
    for t, place in problem.goal.approach(DURATION):
        k = round(t / problem.dt)
        assert np.linalg.norm(plan.end_effector[k] - place.position) < 0.03
    assert plan.position_error[-1] < 0.03
    assert plan.broken.get("corridor", 0.0) < 0.02


def test_an_initial_move_without_an_approach_is_straight(problem: opt.Problem) -> None:
    plan = _start(replace(problem, goal=replace(problem.goal, standoff=0.0)))
    (t, mouth), *_ = problem.goal.approach(DURATION)
    assert np.linalg.norm(plan.end_effector[round(t / problem.dt)] - mouth.position) > 0.05
    reversals = np.diff(np.sign(np.diff(plan.joint_positions, axis=0)), axis=0)
    assert (reversals == 0.0).mean() > 0.99
