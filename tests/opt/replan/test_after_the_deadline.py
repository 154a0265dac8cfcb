"""A re-planned arm with an unmodelled payload, after the deadline."""

from __future__ import annotations

import numpy as np
import pytest

import ffsms_pin as ffsms
from ffsms_pin import opt, simulation
from ffsms_pin.control import ComputedTorque
from ffsms_pin.opt.replan import replanning

DEADLINE, HOLD = 12.0, 8.0


@pytest.fixture(scope="module")
def problem() -> opt.Problem:
    sms = ffsms.load("satellite_panda")
    q0 = sms.home()
    goal = sms.at(q0).end_effector_pose.translation + np.random.default_rng(3).uniform(-0.25, 0.25, 3)
    return opt.Problem(sms, q0, goal, DEADLINE, 0.02)


@pytest.fixture(scope="module")
def plan(problem: opt.Problem) -> opt.Trajectory:
    return opt.solve(problem)


def simulate_with_payload(
    problem: opt.Problem, plan: opt.Trajectory
) -> tuple[ffsms.Tracking, opt.Replanning]:
    reference = opt.Replanning(problem, hold=HOLD, plan=plan)
    payload = simulation.Capture(0.0, 10.0, 0.1 * np.eye(3))
    law = ComputedTorque(problem.sms, K_p=49.0, K_d=14.0, adaptive=False)
    tracking = ffsms.simulate(
        problem.sms,
        reference,
        law,
        dt=5e-3,
        q0=problem.q0,
        conditions=ffsms.Conditions(events=[payload], guards=None),
    )
    return tracking, reference


def error_after_deadline(tracking: ffsms.Tracking) -> float:
    return float(tracking.position_error[tracking.t > DEADLINE + 1.0].max())


@pytest.mark.long
@pytest.mark.slow
def test_commands_wait_for_delayed_joints(
    problem: opt.Problem, plan: opt.Trajectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    waiting, _ = simulate_with_payload(problem, plan)
    rates = np.abs(waiting.v[:, 6:]) / problem.sms.limits.velocity
    assert rates[waiting.t > DEADLINE].max() < 1.0
    assert waiting.position_error[-1] < 0.01
    monkeypatch.setattr(replanning, "_LAG", np.inf)
    monkeypatch.setattr(replanning, "_PATIENCE", np.inf)
    impatient, _ = simulate_with_payload(problem, plan)
    assert error_after_deadline(impatient) > 2.0 * error_after_deadline(waiting)


@pytest.mark.slow
@pytest.mark.long
def test_diverging_corrections_end_at_the_best_posture(
    problem: opt.Problem, plan: opt.Trajectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(replanning, "_LAG", np.inf)
    monkeypatch.setattr(replanning, "_PATIENCE", 0.2)
    tracking, reference = simulate_with_payload(problem, plan)
    assert "did not converge" in reference.note
    moving = np.abs(tracking.v[tracking.t > DEADLINE + HOLD - 0.5, 6:]).max()
    assert moving < 0.1
