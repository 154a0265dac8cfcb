"""Singular values and entropy of many small matrices at once, by the compiled kernel.

`ffsms_pin/kernel/entropy.hpp` has the algorithm: LAPACK, called once a matrix, spends most of its time on
the call, and the eigenvalues of C^T C lose digits.
"""

from __future__ import annotations

import math

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel

__all__ = ["entropies", "singular_values"]


def singular_values(matrices: FloatArray) -> FloatArray:
    """Singular values (min(m, n), B) of a stack of finite matrices (m, n, B), the largest first.

    To 1e-14 of the largest of each matrix; usually to 1e-15.
    """
    m, n, *stack = matrices.shape
    wide = matrices if m <= n else matrices.swapaxes(0, 1)
    return kernel.singular_values(wide, False).reshape(min(m, n), *stack)


def entropies(sigma: FloatArray, n: int) -> FloatArray:
    """The paper's H_norm (...) of singular values (r, ...), of n joints: see `normalised_entropy`."""
    total = sigma.sum(axis=0)
    if n <= 1:
        return np.zeros_like(total)
    share = sigma / np.where(total > 0.0, total, 1.0)
    # 0 log 0 = 0
    logs = np.log(np.where(share > 0.0, share, 1.0))
    found: FloatArray = np.clip(-np.sum(share * logs, axis=0) / math.log(n), 0.0, 1.0)
    return found
