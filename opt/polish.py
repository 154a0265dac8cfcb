"""The exact solution of a quadratic programme whose active rows are known.

ProxQP stops within a tolerance, and where it stops depends in the last digits on where its memory lies: the
same problem can give another last bit in the next run, and a march of a thousand steps makes that visible.
Solving the equations of the active rows once more removes both.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from ffsms_pin.checks import FloatArray

__all__ = ["polish"]

# A polished solution further away than this [in the units of x] comes from the wrong rows.
_NEAR = 1e-5


def polish(H: FloatArray, g: FloatArray, rows: FloatArray, bounds: FloatArray, x: FloatArray) -> FloatArray:
    """Minimise 1/2 x^T H x + g^T x on rows x = bounds.

    Parameters
    ----------
    H : ndarray, shape (n, n)
        Positive definite.
    g : ndarray, shape (n,)
    rows : ndarray, shape (k, n)
        The active rows and bounds, as a solver found them.
    bounds : ndarray, shape (k,)
    x : ndarray, shape (n,)
        The solver's solution: returned where the equations have no solution near it.
    """
    n, k = g.size, bounds.size
    kkt = np.zeros((n + k, n + k), order="F")
    kkt[:n, :n] = H
    kkt[n:, :n] = rows
    kkt[:n, n:] = rows.T
    _, _, solution, info = lapack.dgesv(kkt, np.concatenate([-g, bounds]), overwrite_a=True, overwrite_b=True)
    exact: FloatArray = solution[:n]
    # Written so that a NaN, which a singular system can leave, is not near.
    if info == 0 and float(np.abs(exact - x).max()) < _NEAR:
        return exact
    return x
