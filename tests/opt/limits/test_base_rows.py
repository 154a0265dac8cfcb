"""Limits on the base's motion in single steps."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from base_moves import LIMITS, displaced_target, largest_base_motion, turned_start
from step_parts import make_stepper, plan_stepwise

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.step.state import StepState, stoppable
from ffsms_pin.robot.base_motion import roll_out


@pytest.fixture(scope="module")
def start(panda: ffsms.SpaceManipulator) -> FloatArray:
    return turned_start(panda)


@pytest.mark.parametrize("name", list(LIMITS))
def test_steps_keep_the_limit_and_break_it_without(
    name: str, panda: ffsms.SpaceManipulator, start: FloatArray
) -> None:
    target = displaced_target(panda, start, [0.0, -0.4, -0.3])
    free = plan_stepwise(make_stepper(panda, 0.02), start, target, 6.0)
    held = plan_stepwise(
        make_stepper(panda, 0.02, base=opt.BaseLimits(**{name: LIMITS[name]})), start, target, 6.0
    )
    assert largest_base_motion(panda, start, free.rates, 0.02)[name] > 1.2 * LIMITS[name]
    assert 0.5 * LIMITS[name] < largest_base_motion(panda, start, held.rates, 0.02)[name] <= LIMITS[name]
    assert held.note == ""


def test_limits_count_from_the_base_pose_of_the_first_step_after_a_reset(
    panda: ffsms.SpaceManipulator, start: FloatArray
) -> None:
    stepper = make_stepper(panda, base=opt.BaseLimits(attitude=0.1))
    target, rates, away = panda.at(start).end_effector_pose.translation + 0.2, np.zeros(7), start.copy()
    away[:3] += 0.2
    stepper.step(start, rates, target, 4.0)
    stepper.step(away, rates, target, 4.0)
    np.testing.assert_array_equal(stepper.base_start, start[:7])
    stepper.reset()
    stepper.step(away, rates, target, 4.0)
    np.testing.assert_array_equal(stepper.base_start, away[:7])
    stepper.reset(base_start=start[:7])
    stepper.step(away, rates, target, 4.0)
    np.testing.assert_array_equal(stepper.base_start, start[:7])


@pytest.mark.parametrize("kind", ["attitude", "translation"])
def test_rows_are_the_rate_of_the_distance(
    kind: str, panda: ffsms.SpaceManipulator, start: FloatArray
) -> None:
    """With a vanishing step a row is -d|r|/dt over the joint rates, by finite differences of a rollout."""
    rng, h = np.random.default_rng(3), 1e-6
    q, _ = roll_out(panda, start, rng.normal(size=7), np.zeros((40, 7)), 0.01)

    def distance(row: FloatArray) -> float:
        first, now = panda.at(start).base_pose, panda.at(row).base_pose
        if kind == "attitude":
            return float(np.linalg.norm(pin.log3(first.rotation.T @ now.rotation)))
        return float(np.linalg.norm(now.translation - first.translation))

    for _ in range(4):
        rates = rng.normal(size=7)
        step = StepState(panda, q[-1], rates, 1e-9, 1.0, base_start=start[:7])
        rows = opt.BaseLimits(**{kind: 0.5}).rows(step)
        assert rows is not None
        ahead, _ = roll_out(panda, q[-1], rates, np.zeros((1, 7)), h)
        behind, _ = roll_out(panda, q[-1], -rates, np.zeros((1, 7)), h)
        rate = (distance(ahead[-1]) - distance(behind[-1])) / (2.0 * h)
        assert float(-rows.G[0] @ rates) == pytest.approx(rate, abs=1e-6)
        # The row allows a rate in proportion to the remaining distance.
        assert -rows.lower[0] == pytest.approx(2.0 * (0.97 * 0.5 - distance(q[-1])), abs=1e-6)


def test_rows_include_the_angular_velocity_due_to_momentum(planar: ffsms.SpaceManipulator) -> None:
    """The drift of the base tightens the bound on one side and widens it on the other."""
    q, limits = planar.configuration([0.3, 0.6, 0.5]), opt.BaseLimits(attitude_rate=0.05)
    momentum = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.5])
    drift = StepState(planar, q, np.zeros(3), 0.01, 1.0, momentum).drift[5]
    turning = limits.rows(StepState(planar, q, np.zeros(3), 0.01, 1.0, momentum))
    assert turning is not None
    np.testing.assert_allclose(turning.lower, [drift - 0.97 * 0.05], atol=1e-12)
    # Without momentum, the same base rate due to the joints alone leaves the same slack.
    still = StepState(planar, q, np.zeros(3), 0.01, 1.0)
    rates = drift * np.linalg.pinv(still.reaction[5:6])[:, 0]
    rows = limits.rows(StepState(planar, q, rates, 0.01, 1.0))
    assert rows is not None
    np.testing.assert_allclose(rows.G @ rates - rows.lower, 0.97 * 0.05 - drift, atol=1e-12)


def test_without_limits_there_are_no_rows(planar: ffsms.SpaceManipulator) -> None:
    step = StepState(planar, planar.configuration([0.3, 0.6, 0.5]), np.zeros(3), 0.01, 1.0)
    assert opt.BaseLimits().rows(step) is None


def test_rates_without_time_to_brake_are_not_chosen(panda: ffsms.SpaceManipulator, start: FloatArray) -> None:
    rates = 0.2 * np.ones(7)
    step = StepState(panda, start, rates, 0.02, 2.0)
    slow, fast = 0.98 * rates, 1.02 * rates
    wide, narrow = opt.BaseLimits(attitude=0.5), opt.BaseLimits(attitude=1e-3)
    for limits, chosen in ((wide, fast), (narrow, slow)):
        assert limits.in_braking is not None
        np.testing.assert_array_equal(stoppable([limits.in_braking], step, fast, slow), chosen)
    # A limit on the final attitude is not checked during braking.
    assert opt.BaseLimits(final_attitude=1e-3).in_braking is None
