"""The entropy of the coupling over stacks of configurations, and its gradient."""

from __future__ import annotations

import numpy as np
import pytest

from ffsms_pin.coupling import entropies
from ffsms_pin.opt.rollouts import entropy_and_gradient, singular


@pytest.mark.parametrize("n", [1, 3, 6, 7])
def test_entropy_and_its_gradient(n: int, rng: np.random.Generator) -> None:
    C, h = rng.normal(size=(6, n, 2)), 1e-6
    value, gradient = entropy_and_gradient(C)
    sigma = np.asarray(np.linalg.svd(C[..., 1], compute_uv=False), dtype=np.float64)
    share = sigma / sigma.sum()
    expected = 0.0 if n == 1 else -float(share @ np.log(share)) / np.log(n)
    assert value[1] == pytest.approx(expected, abs=1e-12)
    assert entropies(sigma, n) == pytest.approx(expected, abs=1e-12)
    for index in np.ndindex(6, n):
        step = np.zeros_like(C)
        step[index] = h
        slope = (entropy_and_gradient(C + step)[0] - entropy_and_gradient(C - step)[0]) / (2.0 * h)
        np.testing.assert_allclose(gradient[index], slope, atol=1e-8)


def test_entropy_of_a_coupling_of_deficient_rank(rng: np.random.Generator) -> None:
    """A planar arm of four joints has three singular values; the fourth is rounding."""
    C, h = np.zeros((6, 4, 1)), 1e-6
    C[[0, 1, 5], :, 0] = rng.normal(size=(3, 4))
    value, gradient = entropy_and_gradient(C)
    sigma = np.asarray(np.linalg.svd(C[..., 0], compute_uv=False), dtype=np.float64)
    assert value[0] == pytest.approx(float(entropies(sigma, 4)), abs=1e-6)
    for index in np.ndindex(2, 4):
        step = np.zeros_like(C)
        step[index] = h
        slope = (entropy_and_gradient(C + step)[0] - entropy_and_gradient(C - step)[0]) / (2.0 * h)
        assert gradient[(*index, 0)] == pytest.approx(slope[0], abs=1e-6)


@pytest.mark.parametrize("n", [3, 6, 7])
def test_singular_values_and_vectors(n: int, rng: np.random.Generator) -> None:
    """Compare with LAPACK, also for singular matrices."""
    C = rng.normal(size=(6, n, 3))
    C[2:, :, 1] = 0.0  # of rank two
    C[:, -1, 2] = (1.0 + 1e-7) * C[:, 0, 2]  # nearly singular
    sigma, V = singular(C)
    assert sigma.shape == (min(6, n), 3)
    for k in range(3):
        expected = np.linalg.svd(C[..., k], compute_uv=False)
        np.testing.assert_allclose(sigma[:, k], expected, atol=1e-10 * expected[0])
        np.testing.assert_allclose(V[k].T @ V[k], np.eye(n), atol=1e-12)
        lengths = np.linalg.norm(C[..., k] @ V[k], axis=0)
        np.testing.assert_allclose(lengths[: len(expected)], expected, atol=1e-10 * expected[0])
