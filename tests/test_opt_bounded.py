"""Quadratic programmes with bounds alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.bounded import BoundedProgramme


def problem(rng: np.random.Generator, n: int) -> tuple[FloatArray, FloatArray, list[float], list[float]]:
    B = rng.normal(size=(n, n))
    lower = rng.uniform(-1.0, 0.2, n)
    upper = lower + rng.uniform(0.1, 1.0, n)
    return B @ B.T + 0.1 * np.eye(n), 2.0 * rng.normal(size=n), lower.tolist(), upper.tolist()


@pytest.mark.parametrize("n", [1, 4, 8])
def test_the_solution_is_that_of_bounded_least_squares(n: int) -> None:
    rng, programme = np.random.default_rng(n), BoundedProgramme(n)
    for _ in range(100):
        H, pull, lower, upper = problem(rng, n)
        x = programme.solve(H, pull, lower, upper)
        assert x is not None
        L = np.linalg.cholesky(H)
        expected = lsq_linear(L.T, np.linalg.solve(L, pull), (lower, upper), tol=1e-14).x
        np.testing.assert_allclose(x, expected, rtol=0.0, atol=1e-7)
        # To the last digits: within the bounds exactly, and the slope pushes against those that are reached.
        slope = H @ x - pull
        for i, side in enumerate(programme.sides):
            assert lower[i] <= x[i] <= upper[i]
            if side:
                assert x[i] == (upper[i] if side > 0 else lower[i])
                assert side * slope[i] <= 1e-12
            else:
                assert abs(slope[i]) < 1e-12


def test_the_solution_does_not_depend_on_the_bounds_tried_first() -> None:
    rng = np.random.default_rng(9)
    H, pull, lower, upper = problem(rng, 5)
    programme = BoundedProgramme(5)
    expected = programme.solve(H, pull, lower, upper)
    assert expected is not None
    assert any(programme.sides)
    for _ in range(50):
        programme.sides = rng.integers(-1, 2, 5).tolist()
        x = programme.solve(H, pull, lower, upper)
        assert x is not None
        assert np.array_equal(x, expected)


def test_where_there_is_no_solution_none_is_given() -> None:
    H, pull = np.eye(2), np.array([1.0, np.nan])
    assert BoundedProgramme(2).solve(H, pull, [-1.0, -1.0], [1.0, 1.0]) is None
    assert BoundedProgramme(2).solve(-H, np.ones(2), [-1.0, -1.0], [1.0, 1.0]) is None
