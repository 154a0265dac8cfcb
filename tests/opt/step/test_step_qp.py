"""The quadratic program of a step, against its plain formulas."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from clearances_at import Points
from plain_steps import plain_qp
from step_parts import StepJoints, StepRows, make_stepper

import ffsms_pin as ffsms
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.costs import Term
from ffsms_pin.opt.evaluation import UNBOUNDED, Rows
from ffsms_pin.opt.step.state import StepState
from ffsms_pin.opt.step.stepper import Stepper, StepWeights, step_qp

TARGET = np.array([0.45, 0.75, 0.0])


@pytest.mark.parametrize("name", ["planar_3r", "satellite_panda"])
def test_the_qp_of_a_step_agrees_with_the_plain_formulas(name: str) -> None:
    """A single stepper is used for all states, slow and fast."""
    sms = ffsms.load(name)
    rng, stepper, with_extra_rows = np.random.default_rng(7), make_stepper(sms), 0
    middle, half = 0.5 * (sms.limits.upper + sms.limits.lower), 0.5 * (sms.limits.upper - sms.limits.lower)
    for k in range(30):
        q = sms.configuration(middle + 0.9 * half * rng.uniform(-1.0, 1.0, sms.n))
        rates = (0.1, 0.9)[k % 2] * sms.limits.velocity * rng.uniform(-1.0, 1.0, sms.n)
        stepper.reset()
        built, plain = stepper.build(q, rates, TARGET, 6.0), plain_qp(sms, q, rates, TARGET, 6.0)
        with_extra_rows += len(plain.l) > 2 * sms.n + Points(sms).count
        for result, expected in zip(built, plain, strict=True):
            np.testing.assert_allclose(result, expected, rtol=0.0, atol=1e-12)
    assert (with_extra_rows > 0) == (name == "satellite_panda")


def test_building_a_qp_leaves_no_state(planar: ffsms.SpaceManipulator) -> None:
    q, rates = planar.configuration([0.4, 0.7, -0.5]), np.array([0.1, -0.2, 0.1])
    stepper, fresh = make_stepper(planar), make_stepper(planar)
    stepper.build(planar.configuration([1.0, 0.2, 0.4]), -rates, TARGET, 2.0)
    result, expected = stepper.step(q, rates, TARGET, 5.0), fresh.step(q, rates, TARGET, 5.0)
    np.testing.assert_array_equal(result.joint_rates, expected.joint_rates)


def test_soft_rows_are_relaxed_on_both_sides() -> None:
    """Two rows are hard; three are soft: on both sides, below, and above."""
    rng = np.random.default_rng(0)
    sms = ffsms.load("planar_3r")
    step = StepState(sms, sms.configuration(rng.normal(size=3)), np.zeros(3), 0.01, 5.0)
    hard = Rows(rng.normal(size=(2, 3)), np.array([-1.0, 0.5]), np.array([1.0, 0.7]))
    soft = Rows(
        rng.normal(size=(3, 3)), np.array([-1.0, 0.2, -UNBOUNDED]), np.array([1.0, UNBOUNDED, 0.3]), 0.5
    )
    arguments = TARGET, 1.0, np.zeros(3), None, StepWeights()
    problem = step_qp(step, *arguments, [hard, soft])[1].problem()
    for _ in range(50):
        alpha, slack = rng.normal(size=3), float(rng.uniform(0.0, 2.0))
        x = np.concatenate([alpha, [0.4], [slack]])
        u = step.V @ alpha
        gaps = [
            *(hard.lower - hard.G @ u),
            *(hard.G @ u - hard.upper),
            *(soft.lower - soft.G @ u - 0.5 * slack),
            *(soft.G @ u - soft.upper - 0.5 * slack),
        ]
        assert problem.violation(x) == pytest.approx(max(0.0, *gaps), abs=1e-12)
    assert problem.C.shape == (2 + 2 + 2, 5)


class _Posture(Term):
    """A term that prefers given joint rates."""

    name = "posture"

    def __init__(self, weight: float, rates: FloatArray) -> None:
        self._weight, self._rates = weight, rates

    def residual(self, motions: Any) -> list[Any]:
        return []

    def step_objective(self, step: StepState) -> tuple[FloatArray, FloatArray]:
        return self._weight * np.eye(step.sms.n), self._weight * self._rates


def test_terms_add_to_the_objective() -> None:
    sms, rng = ffsms.load("satellite_panda"), np.random.default_rng(3)
    q = sms.configuration(0.5 * (sms.limits.lower + sms.limits.upper))
    preferred, rates = rng.uniform(-0.1, 0.1, 7), np.zeros(7)
    target = sms.at(q).end_effector_pose.translation + np.array([0.1, -0.2, 0.1])
    with_, without = (
        Stepper(sms, 0.1, 10.0, [StepJoints()], terms) for terms in ([_Posture(1e-3, preferred)], [])
    )
    V = StepState(sms, q, rates, 0.1, 5.0).V
    problems = with_.build(q, rates, target, 5.0), without.build(q, rates, target, 5.0)
    x = rng.normal(size=9)
    u = V @ x[:7]
    share = problems[0].value(x) - problems[1].value(x)
    assert share == pytest.approx(1e-3 * (0.5 * u @ u - preferred @ u), abs=1e-12)
    with_term, without_term = (stepper.step(q, rates, target, 5.0) for stepper in (with_, without))
    distances = (
        np.linalg.norm(with_term.joint_rates - preferred),
        np.linalg.norm(without_term.joint_rates - preferred),
    )
    assert distances[0] < 0.9 * distances[1]
    # The term has less weight than the direction.
    assert with_term.cost < 1e-4


def test_a_custom_limit_is_kept(planar: ffsms.SpaceManipulator) -> None:
    """The limit forbids downward motion, and the target is below."""
    q = planar.configuration([0.4, 0.7, -0.5])
    target = planar.at(q).end_effector_pose.translation + np.array([0.05, -0.4, 0.0])

    def not_down(step: StepState) -> Rows:
        return Rows(step.J_star[1:2], np.zeros(1), np.full(1, UNBOUNDED), softness=1.0)

    for limits, limited in (([StepJoints(), StepRows(not_down)], True), ([StepJoints()], False)):
        stepper, rates = Stepper(planar, 0.01, 10.0, limits), np.zeros(3)
        for k in range(20):
            step = stepper.step(q, rates, target, 4.0 - 0.01 * k)
            assert step.solved
            rates = step.joint_rates
        vertical_velocity = float(StepState(planar, q, rates, 0.01, 1.0).J_star[1] @ rates)
        assert (vertical_velocity >= -1e-9) == limited
