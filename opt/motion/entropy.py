"""The paper's entropy of the coupling at many configurations, with its gradient; see `coupling.stacked`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel, rows

__all__ = ["entropy_and_gradient", "singular"]

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

    By the eigenvalues of C C^T or C^T C, whichever is smaller: see `ffsms_pin/kernel/entropy.hpp`.
    `free_rows` are those that are not zero at all configurations; without any there is no coupling, and the
    entropy is zero.
    """
    n, shape, r = coupling.shape[1], coupling.shape[2:], len(free_rows)
    value, gradient = np.zeros(shape), np.zeros(coupling.shape)
    if n == 1 or not r:
        return value, gradient
    free = coupling if r == 6 else coupling[list(free_rows)]
    by_free = gradient if r == 6 else np.empty(free.shape)
    kernel.entropies(r, n, rows(free, r * n), value.reshape(1, -1), by_free.reshape(r * n, -1))
    if r < 6:
        gradient[list(free_rows)] = by_free
    return value, gradient
