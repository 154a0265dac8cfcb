"""Plans of minutes for a long arm on a tumbling robot, and notes if the arm cannot stay at the target."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.optimize import linprog

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.rollouts import rolled_out
from ffsms_pin.robot.base_motion import roll_out

START = np.array([0.2, 0.6, -0.3, 0.8, 0.1, 0.6, 0.0])
DISPLACEMENT = np.array([0.9, -0.8, 0.7, -0.9, 0.6, 0.5, 0.4])
DURATION, STEPS, FINE = 150.0, 300, 10


def problem_of(drift: float, reach: float) -> opt.Problem:
    """Return a problem to the end of a straight move; the robot first turns at `drift` [deg/s]."""
    sms = ffsms.load("space_arm_7")
    q0 = sms.configuration(START)
    arm = sms.arm_stack().evaluate(START[:, None])
    spin = np.deg2rad(drift) * np.array([0.48, -0.6, 0.64])
    momentum = np.concatenate([np.zeros(3), np.linalg.solve(arm.inverse[..., 0], spin)])
    s = np.linspace(0.0, 1.0, STEPS + 1)[:, None]
    dt = DURATION / STEPS
    end = rolled_out(sms, sms.arm_stack(), q0, 6.0 * s * (1.0 - s) * DISPLACEMENT / DURATION, dt, momentum)
    goal = opt.Position(end.end_effector[:, 0, -1], reach=reach)
    return opt.Problem(sms, q0, goal, DURATION, dt, momentum=momentum)


def distances(problem: opt.Problem, plan: opt.Trajectory) -> FloatArray:
    """Return distances from the target in the last tenth [m] by a rollout in finer steps."""
    accelerations = np.repeat(plan.joint_accelerations, FINE, axis=0)
    q, _ = roll_out(problem.sms, problem.q0, np.zeros(7), accelerations, plan.dt / FINE, problem.momentum)
    late = q[round(0.9 * STEPS) * FINE :: FINE]
    ends = [problem.sms.at(row).end_effector_pose.translation for row in late]
    return np.asarray(np.linalg.norm(np.array(ends) - problem.place.position, axis=1))


@pytest.mark.slow
@pytest.mark.parametrize("drift", [0.5, 2.0])
def test_a_plan_reaches_the_end_of_a_straight_move_while_tumbling(drift: float) -> None:
    problem = problem_of(drift, reach=10.0)
    plan = opt.solve(problem)
    assert plan.reached, plan.note
    assert distances(problem, plan)[-1] < 1e-3
    assert np.abs(plan.joint_rates[-1]).max() < 1e-3


@pytest.mark.slow
def test_an_arm_that_cannot_stay_arrives_at_the_deadline_and_the_note_gives_the_drift() -> None:
    problem = problem_of(2.0, reach=0.02)
    plan = opt.solve(problem)
    assert not plan.reached
    assert plan.within_tolerance
    errors = distances(problem, plan)
    assert errors[-1] < 1e-3
    assert errors.max() > 0.1
    assert "no posture that was tried" not in plan.note
    reported = re.search(r"carries the end effector off by ([\d.]+) m/s.* takes ([\d.]+) times", plan.note)
    assert reported is not None, plan.note
    # Drift of the end effector with joints at rest, by differences, and the least rates against the drift.
    sms, drifts, shares = problem.sms, [], []
    for k in (270, 277, 285, 292, 300):
        q = plan.q[k]
        after, _ = roll_out(sms, q, np.zeros(7), np.zeros((1, 7)), 1e-3, problem.momentum)
        here = sms.at(q)
        drift = (sms.at(after[-1]).end_effector_pose.translation - here.end_effector_pose.translation) / 1e-3
        bounds = np.vstack([np.eye(7), -np.eye(7)]) / np.tile(sms.limits.velocity, 2)[:, None]
        least = linprog(
            [0.0] * 7 + [1.0],
            np.hstack([bounds, -np.ones((14, 1))]),
            np.zeros(14),
            np.hstack([here.J_star[:3], np.zeros((3, 1))]),
            -drift,
            [(None, None)] * 8,
        )
        drifts.append(float(np.linalg.norm(drift)))
        shares.append(least.fun)
    assert float(reported[1]) == pytest.approx(max(drifts), rel=0.05)
    assert float(reported[2]) == pytest.approx(max(shares), rel=0.05)
    assert max(shares) > 1.0


@pytest.mark.slow
@pytest.mark.long
def test_an_arm_that_stays_by_moving_is_reported() -> None:
    """If no posture stays at the target with joints at rest, the plan reports moving joints."""
    problem = problem_of(0.5, reach=0.02)
    without = opt.solve(problem, opt.SearchOptions(without=("moving end", "deadline alone")))
    plan = opt.solve(problem)
    assert plan.reached
    assert distances(problem, plan).max() < 0.02 + 1e-4
    moves = bool(np.abs(plan.joint_rates[-1]).max() > 1e-3)
    assert moves == (not without.reached)
    assert moves == ("the joints still move at the deadline" in plan.note)
