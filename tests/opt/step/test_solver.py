"""ProxQP on programmes of steps: optimality, another solver, warm and cold starts, and failure."""

from __future__ import annotations

import numpy as np
import pytest
from plain_steps import as_solved, by_daqp
from scipy.optimize import nnls
from step_parts import make_stepper

import ffsms_pin as ffsms
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.evaluation import UNBOUNDED
from ffsms_pin.opt.step.stepper import StepProblem, StepSolver

TARGET = np.array([0.45, 0.75, 0.0])


def optimality_gap(problem: StepProblem, x: FloatArray, near: float = 1e-9) -> float:
    """How far the gradient at a feasible x is from a combination of the active rows with the right signs."""
    rows = np.vstack([problem.C, np.eye(x.size)])
    low, high = np.concatenate([problem.l, problem.lower]), np.concatenate([problem.u, problem.upper])
    active = np.vstack([rows[rows @ x > high - near], -rows[rows @ x < low + near]])
    gradient = problem.H @ x + problem.g
    return float(np.linalg.norm(gradient)) if active.size == 0 else float(nnls(active.T, -gradient)[1])


def random_programme(rng: np.random.Generator, n: int, rows: int) -> StepProblem:
    B, C = rng.normal(size=(n, n)), rng.normal(size=(rows, n))
    inside = C @ rng.uniform(-0.9, 0.9, n)  # of all rows: the programme has a solution
    return StepProblem(
        H=B @ B.T + 0.1 * np.eye(n),
        g=3.0 * rng.normal(size=n),
        C=C,
        l=inside - rng.uniform(0.05, 1.0, rows),
        u=inside + rng.uniform(0.05, 1.0, rows),
        lower=np.full(n, -1.0),
        upper=np.ones(n),
    )


def test_random_programmes_one_after_the_other_are_solved_to_the_last_digits() -> None:
    """Unrelated problems: starting from the last one's solution does no harm."""
    rng, solver, start, agree = np.random.default_rng(5), StepSolver(), None, 0
    for _ in range(200):
        problem = random_programme(rng, 5, 8)
        found, cold = solver.solve(as_solved(problem), start), StepSolver().solve(as_solved(problem))
        assert found.solved
        assert problem.violation(found.x) < 1e-12
        assert optimality_gap(problem, found.x) < 1e-10
        np.testing.assert_allclose(found.x, by_daqp(problem), rtol=0.0, atol=1e-8)
        agree += np.array_equal(found.x, cold.x)
        start = (found.x, found.z)
    # To the last bit, but where a multiplier is as small as the tolerance.
    assert agree >= 198


@pytest.mark.parametrize("name", ["planar_3r", "satellite_panda"])
def test_programmes_of_steps_are_solved_to_their_optimality_conditions(name: str) -> None:
    sms, rng = ffsms.load(name), np.random.default_rng(3)
    stepper, bound = make_stepper(sms), 0
    for k in range(30):
        q = sms.configuration(rng.uniform(0.8 * sms.limits.lower, 0.8 * sms.limits.upper))
        rates = (0.2, 0.8)[k % 2] * sms.limits.velocity * rng.uniform(-1.0, 1.0, sms.n)
        stepper.reset()
        problem = stepper.build(q, rates, TARGET, (6.0, 0.5)[k % 3 == 0])
        found = StepSolver().solve(as_solved(problem))
        assert found.solved
        assert problem.violation(found.x) < 1e-9
        assert optimality_gap(problem, found.x, 1e-7) < 1e-7
        other = by_daqp(problem)
        assert problem.value(found.x) <= problem.value(other) + 1e-9
        np.testing.assert_allclose(found.x, other, rtol=0.0, atol=1e-5)
        step = stepper.step(q, rates, TARGET, (6.0, 0.5)[k % 3 == 0])
        assert step.solved
        np.testing.assert_allclose(step.alpha, found.x[: sms.n], rtol=0.0, atol=1e-9)
        bound += int(np.count_nonzero(found.z))
    assert bound > 30


def test_a_programme_without_rows_is_solved() -> None:
    none = np.full(4, UNBOUNDED)
    problem = StepProblem(
        np.eye(4), np.array([1.0, -2.0, 0.5, 0.0]), np.zeros((0, 4)), np.zeros(0), np.zeros(0), -none, none
    )
    found = StepSolver().solve(as_solved(problem))
    assert found.solved
    np.testing.assert_allclose(found.x, [-1.0, 2.0, -0.5, 0.0], atol=1e-12)


@pytest.mark.parametrize("kind", ["contradiction", "nan"])
def test_a_failure_is_reported_and_forgotten(kind: str) -> None:
    rng, solver = np.random.default_rng(1), StepSolver()
    good = random_programme(rng, 9, 30)
    first = solver.solve(as_solved(good))
    if kind == "contradiction":
        C = good.C.copy()
        C[1] = C[0]
        bad = good._replace(C=C, l=np.append([0.9, -0.9], good.l[2:]), u=np.append([1.0, -0.8], good.u[2:]))
    else:
        bad = good._replace(g=np.full(9, np.nan))
    for start in (None, (first.x, first.z), (first.x, first.z)):
        assert not solver.solve(as_solved(bad), start).solved
    np.testing.assert_array_equal(solver.solve(as_solved(good)).x, first.x)
    np.testing.assert_allclose(
        solver.solve(as_solved(good), (first.x, first.z)).x, first.x, rtol=0.0, atol=1e-12
    )


def test_a_start_that_leads_nowhere_gives_way_to_nothing() -> None:
    rng, solver = np.random.default_rng(2), StepSolver()
    problem = random_programme(rng, 5, 8)
    expected = StepSolver().solve(as_solved(problem)).x
    wild = (1e9 * rng.normal(size=5), 1e12 * rng.normal(size=13))
    np.testing.assert_allclose(solver.solve(as_solved(problem), wild).x, expected, rtol=0.0, atol=1e-9)
    other_size = (np.zeros(4), np.zeros(3))
    np.testing.assert_allclose(solver.solve(as_solved(problem), other_size).x, expected, rtol=0.0, atol=1e-12)
