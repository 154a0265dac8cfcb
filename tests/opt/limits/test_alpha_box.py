"""The paper's box |alpha_i| <= 1: exact where feasible, violations reported."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from horizon_parts import COARSE, node_rates, spline_of
from part_cases import problem_of, rollout_of, size_of
from slopes import by_differences, by_slopes, motions
from step_parts import StepJoints, make_stepper

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.opt.evaluation import residuals_of
from ffsms_pin.opt.limits.alpha_box import AlphaBox
from ffsms_pin.opt.step.state import StepState, roll_out_steps
from ffsms_pin.opt.step.stepper import Stepper
from ffsms_pin.opt.trajectory import measure
from ffsms_pin.robot.base_motion import advance

TARGET = np.array([0.45, 0.75, 0.0])


@pytest.fixture(scope="module")
def fast() -> ffsms.SpaceManipulator:
    """An arm with generous joint limits, whose rates the box alone limits."""
    sms = ffsms.load("planar_3r")
    return sms.with_limits(replace(sms.limits, velocity=np.full(3, 50.0), acceleration=np.full(3, 500.0)))


def largest_alpha(stepper: Stepper, duration: float) -> float:
    sms, dt, largest = stepper.sms, stepper.dt, 0.0
    q, rates = sms.configuration([0.4, 0.7, -0.5]), np.zeros(3)
    for k in range(round(duration / dt)):
        step = stepper.advance(q, rates, TARGET, duration - k * dt)
        assert step.solved
        largest = max(largest, float(np.abs(step.alpha).max()))
        q, _ = advance(sms, q, rates, (step.joint_rates - rates) / dt, dt)
        rates = step.joint_rates
    return largest


def test_alpha_stays_in_the_box_and_leaves_it_without(fast: ffsms.SpaceManipulator) -> None:
    assert 0.999 < largest_alpha(make_stepper(fast), 0.2) <= 1.0 + 1e-6
    assert largest_alpha(Stepper(fast, 0.01, 10.0, [StepJoints()]), 0.2) > 2.0


def test_rows_are_hard_at_slow_rates(planar: ffsms.SpaceManipulator) -> None:
    step = StepState(planar, planar.configuration([0.4, 0.7, -0.5]), np.full(3, 0.3), 0.01, 5.0)
    rows = AlphaBox().rows(step)
    np.testing.assert_array_equal(rows.G, step.V.T)
    assert rows.softness == 0.0
    assert (rows.lower == -1.0).all()
    assert (rows.upper == 1.0).all()


def test_an_infeasible_box_is_softened_and_its_violation_reported(fast: ffsms.SpaceManipulator) -> None:
    """Rates of twice the box return to it in one step if the acceleration limit allows."""
    q = fast.configuration([0.4, 0.7, -0.5])
    step = StepState(fast, q, np.zeros(3), 0.01, 5.0)
    rates = 2.0 * step.V[:, 0]
    assert AlphaBox().rows(StepState(fast, q, rates, 0.01, 5.0)).softness == 0.0
    back = make_stepper(fast).step(q, rates, TARGET, 5.0)
    assert back.solved
    assert np.abs(back.alpha).max() <= 1.0 + 1e-9
    assert back.slack < 1e-9

    slow = fast.with_limits(replace(fast.limits, acceleration=np.full(3, 10.0)))
    assert AlphaBox().rows(StepState(slow, q, rates, 0.01, 5.0)).softness > 0.0
    step_ = make_stepper(slow, collision="off").step(q, rates, TARGET, 5.0)
    assert step_.solved
    assert np.abs(step_.alpha).max() > 1.5
    assert step_.slack > 1e-3
    # The violation is the smallest possible: the rates return as fast as the joints can.
    assert np.abs(step_.joint_rates - rates).max() == pytest.approx(0.1, abs=1e-9)
    assert AlphaBox().rows(step).softness == 0.0


@pytest.fixture(scope="module")
def brisk(planar: ffsms.SpaceManipulator) -> ffsms.SpaceManipulator:
    """An arm whose joint limits allow rates outside the paper's box."""
    limits = replace(planar.limits, velocity=np.full(3, 3.0), acceleration=np.full(3, 6.0))
    return planar.with_limits(limits)


def test_rollouts_keep_the_box(brisk: ffsms.SpaceManipulator) -> None:
    goal, largest = np.array([0.3, -0.8, 0.0]), {}
    for box in (False, True):
        limits: list[opt.Limit] = [opt.JointLimits(), opt.AlphaBox()][: 1 + box]
        problem = problem_of(brisk, goal=goal, duration=2.0, limits=limits)
        rates = roll_out_steps(Stepper(brisk, 0.02, 10.0, limits), problem.q0, np.zeros(3), goal, 2.0)[0]
        plan = measure(replace(problem, limits=[opt.JointLimits(), opt.AlphaBox()]), rates)
        largest[box] = plan.largest_alpha
        assert plan.broken.get("alpha box", 0.0) == pytest.approx(max(0.0, largest[box] - 1.0), abs=1e-9)
    assert largest[False] > 1.2
    assert largest[True] <= 1.0 + 1e-9


def test_derivatives_and_violation_of_the_box_over_a_motion(
    brisk: ffsms.SpaceManipulator, rng: np.random.Generator
) -> None:
    problem = problem_of(brisk, duration=2.0)
    spline, box = spline_of(problem, COARSE, free_end=True), opt.AlphaBox()
    p = 1.5 * rng.normal(size=(1, spline.size, 3))
    residuals = residuals_of(box, motions(problem, spline, p))
    assert size_of(residuals) > 0.1
    slopes = by_slopes(problem, spline, p, residuals)
    differences = by_differences(problem, spline, p, partial(residuals_of, box))
    np.testing.assert_allclose(slopes, differences, rtol=0.0, atol=1e-5 * np.abs(differences).max())
    # A motion without residual violates nothing.
    for share in (0.0, 0.3, 0.6, 1.0):
        motion = rollout_of(problem, node_rates(problem, spline, share * p[0]))
        if size_of(residuals_of(box, motion)) == 0.0:
            assert box.violation(motion).amount == 0.0
        if box.violation(motion).amount > 0.1:
            assert size_of(residuals_of(box, motion)) > box.margin
