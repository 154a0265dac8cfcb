"""The paper's entropy of the coupling at many configurations, with its gradient; see `coupling.stacked`."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ffsms_pin.checks import FloatArray

__all__ = ["entropy_and_gradient", "singular"]

# Singular values are kept above this: x log x is zero there to rounding, and its slope is finite.
_LEAST = 1e-12
# And above this share of the largest, where they come from their squares.
_SHARE = 1e-8
# Below this share, squares cost digits that show.
_FEW_DIGITS = 1e-4


def singular(coupling: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Singular values (min(6, n), B), largest first, and V (B, n, n) of stacked C_bm (6, n, B).

    By the eigenvalues of C^T C, three times faster than singular values; these where the former lose digits.
    """
    n = coupling.shape[1]
    eigenvalues, vectors = np.linalg.eigh(np.einsum("kib,kjb->bij", coupling, coupling))
    sigma, V = np.sqrt(np.maximum(eigenvalues[:, ::-1], 0.0)), vectors[:, :, ::-1].copy()
    sigma = sigma[:, :6].copy()
    poor = sigma[:, -1] < _FEW_DIGITS * sigma[:, 0]
    if poor.any():
        V[poor], sigma[poor], _ = np.linalg.svd(coupling[..., poor].transpose(2, 1, 0), full_matrices=n > 6)
    return sigma.T, V


def entropy_and_gradient(
    coupling: FloatArray, free_rows: Sequence[int] = range(6)
) -> tuple[FloatArray, FloatArray]:
    """H_norm (...) of stacked C_bm (6, n, ...), and its gradient (6, n, ...).

    By the eigenvalues of C C^T or C^T C, whichever is smaller: several times faster than singular values.
    `free_rows` are those that are not zero at all configurations; without any there is no coupling, and the
    entropy is zero.
    """
    n, shape, r = coupling.shape[1], coupling.shape[2:], len(free_rows)
    if n == 1 or not r:
        return np.zeros(shape), np.zeros_like(coupling)
    if r < 6:
        rows, gradient = coupling[list(free_rows)], np.zeros_like(coupling)
        value, gradient[list(free_rows)] = _of_rows(rows)
        return value, gradient
    return _of_rows(coupling)


def _of_rows(coupling: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The same, of rows (r, n, ...)."""
    r, n = coupling.shape[:2]
    shape = coupling.shape[2:]
    C = coupling.reshape(r, n, -1)
    # Rows that are zero, as those of a planar arm, are exactly so from the left only.
    by_rows = n > r or n == r < 6
    square = np.einsum("ikb,jkb->ijb" if by_rows else "kib,kjb->ijb", C, C)
    eigenvalues, vectors = np.linalg.eigh(square.transpose(2, 0, 1))
    sigma, V = np.sqrt(np.maximum(eigenvalues, _LEAST**2)).T.copy(), vectors.transpose(1, 2, 0).copy()
    sigma = np.maximum(sigma, _SHARE * sigma[-1])
    value, slope = _entropy(sigma, n)
    # With C = U sigma V^T the gradient is U slope V^T = C V (slope / sigma) V^T, or from the left.
    W = np.einsum("ikb,jkb->ijb", V * (slope / sigma), V)
    left, right = (W, C) if by_rows else (C, W)
    gradient = np.einsum("ijb,jkb->ikb", left, right)
    return value.reshape(shape), gradient.reshape(coupling.shape)


def _entropy(sigma: FloatArray, n: int) -> tuple[FloatArray, FloatArray]:
    """Entropy (...) and its slopes by the singular values (r, ...)."""
    total = sigma.sum(axis=0)
    share = sigma / total
    logs = np.log(share)
    plain = np.sum(share * logs, axis=0)
    return -plain / math.log(n), (plain - logs) / (total * math.log(n))
