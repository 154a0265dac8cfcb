"""Poles of a linear second-order error."""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray

__all__ = ["time_constants"]


def time_constants(H: FloatArray, K_d: FloatArray, K_p: FloatArray) -> FloatArray:
    """Time constants -1 / Re(pole) (2 n,) [s], ascending, of H x'' + K_d x' + K_p x = 0."""
    n = H.shape[0]
    A = np.zeros((2 * n, 2 * n))
    A[:n, n:] = np.eye(n)
    A[n:, :n] = -np.linalg.solve(H, K_p)
    A[n:, n:] = -np.linalg.solve(H, K_d)
    return np.sort(-1.0 / np.linalg.eigvals(A).real)
