"""ProxQP on the problems of steps: optimality, another solver, warm and cold starts, and failure."""

from __future__ import annotations

import numpy as np
import pytest
from plain_steps import by_daqp, with_bound_rows
from scipy.optimize import nnls
from step_parts import make_stepper

import ffsms_pin as ffsms
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.evaluation import UNBOUNDED
from ffsms_pin.opt.step.stepper import StepProblem, StepSolver

TARGET = np.array([0.45, 0.75, 0.0])


def optimality_gap(problem: StepProblem, x: FloatArray, tolerance: float = 1e-9) -> float:
    """Return the residual of the stationarity condition at a feasible x."""
    rows = np.vstack([problem.C, np.eye(x.size)])
    low, high = np.concatenate([problem.l, problem.lower]), np.concatenate([problem.u, problem.upper])
    active = np.vstack([rows[rows @ x > high - tolerance], -rows[rows @ x < low + tolerance]])
    gradient = problem.H @ x + problem.g
    return float(np.linalg.norm(gradient)) if active.size == 0 else float(nnls(active.T, -gradient)[1])


def random_problem(rng: np.random.Generator, n: int, rows: int) -> StepProblem:
    B, C = rng.normal(size=(n, n)), rng.normal(size=(rows, n))
    centre = C @ rng.uniform(-0.9, 0.9, n)  # feasible for all rows
    return StepProblem(
        H=B @ B.T + 0.1 * np.eye(n),
        g=3.0 * rng.normal(size=n),
        C=C,
        l=centre - rng.uniform(0.05, 1.0, rows),
        u=centre + rng.uniform(0.05, 1.0, rows),
        lower=np.full(n, -1.0),
        upper=np.ones(n),
    )


def test_unrelated_problems_with_warm_starts_are_solved_to_full_precision() -> None:
    rng, solver, start = np.random.default_rng(5), StepSolver(), None
    for _ in range(200):
        problem = random_problem(rng, 5, 8)
        solution = solver.solve(with_bound_rows(problem), start)
        assert solution.solved
        assert problem.violation(solution.x) < 1e-12
        assert optimality_gap(problem, solution.x) < 1e-10
        np.testing.assert_allclose(solution.x, by_daqp(problem), rtol=0.0, atol=1e-8)
        cold = StepSolver().solve(with_bound_rows(problem))
        np.testing.assert_allclose(solution.x, cold.x, rtol=0.0, atol=1e-12)
        start = (solution.x, solution.z)


@pytest.mark.parametrize("name", ["planar_3r", "satellite_panda"])
def test_qps_of_steps_satisfy_their_optimality_conditions(name: str) -> None:
    sms, rng = ffsms.load(name), np.random.default_rng(3)
    stepper, bound = make_stepper(sms), 0
    for k in range(30):
        q = sms.configuration(rng.uniform(0.8 * sms.limits.lower, 0.8 * sms.limits.upper))
        rates = (0.2, 0.8)[k % 2] * sms.limits.velocity * rng.uniform(-1.0, 1.0, sms.n)
        stepper.reset()
        problem = stepper.build(q, rates, TARGET, (6.0, 0.5)[k % 3 == 0])
        solution = StepSolver().solve(with_bound_rows(problem))
        assert solution.solved
        assert problem.violation(solution.x) < 1e-9
        assert optimality_gap(problem, solution.x, 1e-7) < 1e-7
        other = by_daqp(problem)
        assert problem.value(solution.x) <= problem.value(other) + 1e-9
        np.testing.assert_allclose(solution.x, other, rtol=0.0, atol=1e-5)
        step = stepper.step(q, rates, TARGET, (6.0, 0.5)[k % 3 == 0])
        assert step.solved
        np.testing.assert_allclose(step.alpha, solution.x[: sms.n], rtol=0.0, atol=1e-9)
        bound += int(np.count_nonzero(solution.z))
    assert bound > 30


def test_a_qp_without_rows_is_solved() -> None:
    unbounded = np.full(4, UNBOUNDED)
    problem = StepProblem(
        np.eye(4),
        np.array([1.0, -2.0, 0.5, 0.0]),
        np.zeros((0, 4)),
        np.zeros(0),
        np.zeros(0),
        -unbounded,
        unbounded,
    )
    solution = StepSolver().solve(with_bound_rows(problem))
    assert solution.solved
    np.testing.assert_allclose(solution.x, [-1.0, 2.0, -0.5, 0.0], atol=1e-12)


@pytest.mark.parametrize("kind", ["contradiction", "nan"])
def test_a_failure_is_reported_and_does_not_affect_later_solutions(kind: str) -> None:
    rng, solver = np.random.default_rng(1), StepSolver()
    good = random_problem(rng, 9, 30)
    first = solver.solve(with_bound_rows(good))
    if kind == "contradiction":
        C = good.C.copy()
        C[1] = C[0]
        bad = good._replace(C=C, l=np.append([0.9, -0.9], good.l[2:]), u=np.append([1.0, -0.8], good.u[2:]))
    else:
        bad = good._replace(g=np.full(9, np.nan))
    for start in (None, (first.x, first.z), (first.x, first.z)):
        assert not solver.solve(with_bound_rows(bad), start).solved
    np.testing.assert_array_equal(solver.solve(with_bound_rows(good)).x, first.x)
    np.testing.assert_allclose(
        solver.solve(with_bound_rows(good), (first.x, first.z)).x, first.x, rtol=0.0, atol=1e-12
    )


def test_a_useless_warm_start_does_not_change_the_solution() -> None:
    rng, solver = np.random.default_rng(2), StepSolver()
    problem = random_problem(rng, 5, 8)
    expected = StepSolver().solve(with_bound_rows(problem)).x
    wild = (1e9 * rng.normal(size=5), 1e12 * rng.normal(size=13))
    np.testing.assert_allclose(solver.solve(with_bound_rows(problem), wild).x, expected, rtol=0.0, atol=1e-9)
    other_size = (np.zeros(4), np.zeros(3))
    np.testing.assert_allclose(
        solver.solve(with_bound_rows(problem), other_size).x, expected, rtol=0.0, atol=1e-12
    )
