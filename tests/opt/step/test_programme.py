"""The programme of a step, against its plain formulas, term by term."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from clearances_at import Points
from plain_steps import plain_programme
from step_parts import StepJoints, StepRows, make_stepper

import ffsms_pin as ffsms
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.costs import Term
from ffsms_pin.opt.evaluation import UNBOUNDED, Rows
from ffsms_pin.opt.step.state import StepState
from ffsms_pin.opt.step.stepper import Stepper, StepWeights, step_qp

TARGET = np.array([0.45, 0.75, 0.0])


@pytest.mark.parametrize("name", ["planar_3r", "satellite_panda"])
def test_the_built_programme_is_that_of_the_plain_formulas(name: str) -> None:
    """One stepper for all states, fast ones among them: nothing of one is left in the next."""
    sms = ffsms.load(name)
    rng, stepper, gave = np.random.default_rng(7), make_stepper(sms), 0
    middle, half = 0.5 * (sms.limits.upper + sms.limits.lower), 0.5 * (sms.limits.upper - sms.limits.lower)
    for k in range(30):
        q = sms.configuration(middle + 0.9 * half * rng.uniform(-1.0, 1.0, sms.n))
        rates = (0.1, 0.9)[k % 2] * sms.limits.velocity * rng.uniform(-1.0, 1.0, sms.n)
        stepper.reset()
        built, plain = stepper.build(q, rates, TARGET, 6.0), plain_programme(sms, q, rates, TARGET, 6.0)
        gave += len(plain.l) > 2 * sms.n + Points(sms).count
        for found, expected in zip(built, plain, strict=True):
            np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12)
    assert (gave > 0) == (name == "satellite_panda")


def test_building_remembers_nothing(planar: ffsms.SpaceManipulator) -> None:
    q, rates = planar.configuration([0.4, 0.7, -0.5]), np.array([0.1, -0.2, 0.1])
    stepper, fresh = make_stepper(planar), make_stepper(planar)
    stepper.build(planar.configuration([1.0, 0.2, 0.4]), -rates, TARGET, 2.0)
    found, expected = stepper.step(q, rates, TARGET, 5.0), fresh.step(q, rates, TARGET, 5.0)
    np.testing.assert_array_equal(found.joint_rates, expected.joint_rates)


def test_rows_with_two_sides_give_way_on_each() -> None:
    """Of two rows that are hard, and three that give way: one on both sides, one below, one above."""
    rng = np.random.default_rng(0)
    sms = ffsms.load("planar_3r")
    step = StepState(sms, sms.configuration(rng.normal(size=3)), np.zeros(3), 0.01, 5.0)
    hard = Rows(rng.normal(size=(2, 3)), np.array([-1.0, 0.5]), np.array([1.0, 0.7]))
    soft = Rows(
        rng.normal(size=(3, 3)), np.array([-1.0, 0.2, -UNBOUNDED]), np.array([1.0, UNBOUNDED, 0.3]), 0.5
    )
    given = TARGET, 1.0, np.zeros(3), None, StepWeights()
    problem = step_qp(step, *given, [hard, soft])[1].problem()
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
    """Joint rates that are wished for."""

    name = "posture"

    def __init__(self, weight: float, rates: FloatArray) -> None:
        self._weight, self._rates = weight, rates

    def residual(self, motions: Any) -> list[Any]:
        return []

    def step_objective(self, step: StepState) -> tuple[FloatArray, FloatArray]:
        return self._weight * np.eye(step.sms.n), self._weight * self._rates


def test_terms_add_to_the_objective_as_they_say() -> None:
    sms, rng = ffsms.load("satellite_panda"), np.random.default_rng(3)
    q = sms.configuration(0.5 * (sms.limits.lower + sms.limits.upper))
    wished, rates = rng.uniform(-0.1, 0.1, 7), np.zeros(7)
    target = sms.at(q).end_effector_pose.translation + np.array([0.1, -0.2, 0.1])
    with_, without = (
        Stepper(sms, 0.1, 10.0, [StepJoints()], terms) for terms in ([_Posture(1e-3, wished)], [])
    )
    V = StepState(sms, q, rates, 0.1, 5.0).V
    problems = with_.build(q, rates, target, 5.0), without.build(q, rates, target, 5.0)
    x = rng.normal(size=9)
    u = V @ x[:7]
    share = problems[0].value(x) - problems[1].value(x)
    assert share == pytest.approx(1e-3 * (0.5 * u @ u - wished @ u), abs=1e-12)
    near, far = (stepper.step(q, rates, target, 5.0) for stepper in (with_, without))
    gap = np.linalg.norm(near.joint_rates - wished), np.linalg.norm(far.joint_rates - wished)
    assert gap[0] < 0.9 * gap[1]
    # It ranks below the direction.
    assert near.cost < 1e-4


def test_a_limit_may_be_written_by_anyone(planar: ffsms.SpaceManipulator) -> None:
    """The end effector must not move down, although the target is there."""
    q = planar.configuration([0.4, 0.7, -0.5])
    target = planar.at(q).end_effector_pose.translation + np.array([0.05, -0.4, 0.0])

    def not_down(step: StepState) -> Rows:
        return Rows(step.J_star[1:2], np.zeros(1), np.full(1, UNBOUNDED), softness=1.0)

    for limits, held in (([StepJoints(), StepRows(not_down)], True), ([StepJoints()], False)):
        stepper, rates = Stepper(planar, 0.01, 10.0, limits), np.zeros(3)
        for k in range(20):
            step = stepper.step(q, rates, target, 4.0 - 0.01 * k)
            assert step.solved
            rates = step.joint_rates
        falls = float(StepState(planar, q, rates, 0.01, 1.0).J_star[1] @ rates)
        assert (falls >= -1e-9) == held
