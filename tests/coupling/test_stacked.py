"""Singular values and entropies of stacks of matrices, against LAPACK and single matrices."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from ffsms_pin.coupling import entropies, entropy_of_values, singular_values

Array = NDArray[np.float64]
COUNT = 400


def with_values(rng: np.random.Generator, exact: Array) -> Array:
    """Return random matrices (6, 7, B) with singular values (6, B)."""
    U, _ = np.linalg.qr(rng.normal(size=(exact.shape[1], 6, 6)))
    V, _ = np.linalg.qr(rng.normal(size=(exact.shape[1], 7, 7)))
    return np.asarray(np.einsum("bik,kb,bjk->ijb", U, exact, V[:, :, :6]))


def cases(rng: np.random.Generator) -> dict[str, Array]:
    """Return stacks with one numerical difficulty each."""
    planar = np.zeros((6, 4, COUNT))
    planar[[0, 1, 5]] = rng.normal(size=(3, 4, COUNT))
    return {
        "wide": rng.normal(size=(6, 7, COUNT)),
        "tall": rng.normal(size=(6, 3, COUNT)),
        "one column": rng.normal(size=(6, 1, COUNT)),
        "planar, rank 3": planar,
        "zero": np.zeros((6, 7, 3)),
        "identity": np.eye(6, 7)[..., None].repeat(3, 2),
        "ones": np.ones((6, 7, 3)),
        "zeros and ones": rng.integers(0, 2, (6, 7, 5 * COUNT)).astype(float),
        "all equal": with_values(rng, np.ones((6, COUNT))),
        "in clusters": with_values(rng, rng.integers(0, 3, (6, COUNT)).astype(float)),
        "graded": with_values(rng, 10.0 ** rng.uniform(-12.0, 0.0, (6, COUNT))),
        "nearly equal": with_values(rng, 1.0 + 1e-9 * rng.normal(size=(6, COUNT))),
        "large": 1e200 * rng.normal(size=(6, 7, COUNT)),
        "small": 1e-200 * rng.normal(size=(6, 7, COUNT)),
    }


@pytest.mark.parametrize("case", cases(np.random.default_rng(0)))
def test_singular_values_agree_with_lapack(case: str, rng: np.random.Generator) -> None:
    matrices = cases(rng)[case]
    copy = matrices.copy()
    values = singular_values(matrices)
    expected = np.linalg.svd(matrices.transpose(2, 0, 1), compute_uv=False).T
    assert values.shape == expected.shape
    assert (np.abs(values - expected) <= 2e-14 * expected[0]).all()
    assert (np.diff(values, axis=0) <= 0.0).all()
    np.testing.assert_array_equal(matrices, copy)


def test_small_singular_values_are_more_precise_than_by_squares(rng: np.random.Generator) -> None:
    exact = np.sort(10.0 ** rng.uniform(-9.0, 0.0, (6, COUNT)), axis=0)[::-1]
    matrices = with_values(rng, exact)
    squares = np.linalg.eigvalsh(np.einsum("ikb,jkb->bij", matrices, matrices))
    by_squares = np.sqrt(np.maximum(squares, 0.0))[:, ::-1].T
    assert np.abs(singular_values(matrices) - exact).max() < 3e-15
    assert np.abs(by_squares - exact).max() > 1e-10


@pytest.mark.parametrize("n", [1, 3, 7])
def test_stacked_entropies_equal_single_entropies(n: int, rng: np.random.Generator) -> None:
    sigma = np.sort(rng.uniform(size=(min(n, 6), 50)), axis=0)[::-1].copy()
    sigma[-1, :10] = 0.0
    sigma[:, 10] = 0.0
    values = entropies(sigma, n)
    expected = [entropy_of_values(column.tolist(), n) for column in sigma.T]
    np.testing.assert_allclose(values, expected, rtol=0.0, atol=1e-14)
