"""The paper's nonlinear step keeps its limits and approaches the target."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from clearances_at import Points
from step_parts import StepClearance, StepJoints

import ffsms_pin as ffsms
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.limits.alpha_box import AlphaBox
from ffsms_pin.opt.step.state import StepState, roll_out_steps
from ffsms_pin.opt.step.stepwise import PaperStepper
from ffsms_pin.robot.base_motion import roll_out

TARGET = np.array([0.45, 0.75, 0.0])


@pytest.mark.parametrize("kappa", [10.0, 1000.0])
def test_a_rollout_approaches_the_target_within_its_limits(
    planar: ffsms.SpaceManipulator, kappa: float
) -> None:
    """The rollout ends within 0.1 m of a target 0.6 m away; chatter on the cone prevents arrival."""
    dt, q0 = 0.05, planar.configuration(np.deg2rad([1.0, 1.0, 1.0]))
    stepper = PaperStepper(planar, dt, kappa, [StepJoints(), AlphaBox(), StepClearance(0.01)])
    rates, note = roll_out_steps(stepper, q0, np.zeros(3), TARGET, 12.0)
    q, _ = roll_out(planar, q0, rates[0], np.diff(rates, axis=0) / dt, dt)
    assert np.linalg.norm(planar.at(q[-1]).end_effector_pose.translation - TARGET) < 0.1
    assert note == ""
    assert (np.abs(rates) <= planar.limits.velocity + 1e-9).all()
    assert (np.abs(np.diff(rates, axis=0)) <= dt * planar.limits.acceleration + 1e-9).all()
    points = Points(planar)
    assert min(points.values(row).min() for row in q) > 0.01 - 1e-3


def test_alpha_stays_in_the_box(planar: ffsms.SpaceManipulator) -> None:
    fast = planar.with_limits(
        dataclasses.replace(planar.limits, velocity=np.full(3, 50.0), acceleration=np.full(3, 500.0))
    )
    stepper = PaperStepper(fast, 0.01, 10.0, [StepJoints()])
    q, rates, largest = fast.configuration([0.4, 0.7, -0.5]), np.zeros(3), 0.0
    for k in range(10):
        step = stepper.advance(q, rates, TARGET, 5.0 - 0.01 * k)
        assert step.solved
        largest = max(largest, float(np.abs(step.alpha).max()))
        rates = step.joint_rates
    assert 0.9 < largest <= 1.0 + 1e-9


def test_the_gradient_of_the_cost_agrees_with_finite_differences(planar: ffsms.SpaceManipulator) -> None:
    rng, h = np.random.default_rng(0), 1e-6
    stepper = PaperStepper(planar, 0.01, 10.0, [])
    step = StepState(planar, planar.configuration([0.4, 0.7, -0.5]), np.zeros(3), 0.01, 5.0)
    A, towards = step.J_star[:3] @ step.V, np.array([0.6, 0.8, 0.0])
    for _ in range(5):
        alpha = rng.normal(size=3)
        _, slope = stepper._cost(alpha, A, towards, step.entropy)
        for i in range(3):
            change = h * np.eye(3)[i]
            ahead, _ = stepper._cost(alpha + change, A, towards, step.entropy)
            behind, _ = stepper._cost(alpha - change, A, towards, step.entropy)
            assert slope[i] == pytest.approx((ahead - behind) / (2.0 * h), abs=1e-7)


def test_the_papers_step_refuses_attitudes(planar: ffsms.SpaceManipulator) -> None:
    stepper = PaperStepper(planar, 0.01, 10.0, [])
    with pytest.raises(InvalidValue, match="attitude"):
        stepper.advance(planar.configuration([0.1, 0.2, 0.3]), np.zeros(3), TARGET, 1.0, np.eye(3))
