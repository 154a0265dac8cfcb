"""The paper's entropy of the coupling at many configurations, with its gradient."""

from __future__ import annotations

import math

import numpy as np

from ffsms_pin.checks import FloatArray

__all__ = ["entropy", "entropy_and_gradient"]

# Singular values are kept above this: x log x is zero there to rounding, and its slope is finite.
_LEAST = 1e-12


def entropy(coupling: FloatArray) -> FloatArray:
    """H_norm (B,) of stacked transposed C_bm (B, n, 6)."""
    n = coupling.shape[1]
    if n == 1:
        return np.zeros(len(coupling))
    sigma = np.maximum(np.linalg.svd(coupling, compute_uv=False), _LEAST)
    return _entropy(sigma, n)[0]


def entropy_and_gradient(coupling: FloatArray) -> tuple[FloatArray, FloatArray]:
    """H_norm (B,) of stacked transposed C_bm (B, n, 6), and its gradient (B, n, 6)."""
    n = coupling.shape[1]
    if n == 1:
        return np.zeros(len(coupling)), np.zeros_like(coupling)
    U, sigma, Vt = np.linalg.svd(coupling, full_matrices=False)
    value, slope = _entropy(np.maximum(sigma, _LEAST), n)
    return value, (U * slope[:, None, :]) @ Vt


def _entropy(sigma: FloatArray, n: int) -> tuple[FloatArray, FloatArray]:
    """Entropy and its slopes by the singular values (B, r)."""
    total = sigma.sum(axis=1, keepdims=True)
    logs = np.log(sigma / total)
    plain = np.sum(sigma / total * logs, axis=1, keepdims=True)
    return -plain[:, 0] / math.log(n), (plain - logs) / (total * math.log(n))
