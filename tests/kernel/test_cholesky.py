"""The kernel's Cholesky factor and its triangular solves against NumPy's and SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_triangular

from ffsms_pin.kernel import kernel


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 7, 8, 51, 126])
def test_the_factor_and_its_solutions_agree_with_numpy_and_scipy(n: int, rng: np.random.Generator) -> None:
    root = rng.normal(size=(n, n + 2))
    matrix = root @ root.T
    factor = kernel.cholesky(matrix)
    assert factor is not None
    upper = np.triu(factor)
    np.testing.assert_allclose(
        upper, np.linalg.cholesky(matrix).T, rtol=0.0, atol=1e-12 * np.abs(matrix).max()
    )
    scale = 1e-13 * np.linalg.cond(upper)
    for count in (1, 3, 40):
        right = rng.normal(size=(n, count))
        solution = kernel.solve_lower(factor, right)
        np.testing.assert_allclose(
            solution, solve_triangular(upper, right, trans=1), rtol=0.0, atol=scale * 10
        )
    upper_solution = kernel.solve_upper(factor, right[:, 0])
    np.testing.assert_allclose(
        upper_solution, solve_triangular(upper, right[:, 0]), rtol=0.0, atol=scale * 10
    )


def test_a_matrix_that_is_not_positive_definite_has_no_factor() -> None:
    assert kernel.cholesky(np.array([[1.0, 2.0], [2.0, 1.0]])) is None
    assert kernel.cholesky(np.zeros((3, 3))) is None
    assert kernel.cholesky(np.full((2, 2), np.nan)) is None
