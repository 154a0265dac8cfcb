"""Singular values and entropy of many small matrices at once, in numpy.

LAPACK, called once a matrix, spends most of its time on the call. Here every operation runs over the whole
stack: Householder reflections make the matrices bidiagonal, then the differential qd algorithm finds the
squares of the singular values. It only adds, multiplies and divides positive numbers, so small singular
values keep their digits; the eigenvalues of C^T C lose them.

References
----------
K. V. Fernando, B. N. Parlett, "Accurate singular values and differential qd algorithms", Numerische
Mathematik 67 (1994). The shift is Laguerre's bound: B. N. Parlett, "Laguerre's method applied to the matrix
eigenvalue problem", Mathematics of Computation 18 (1964).
"""

from __future__ import annotations

import math

import numpy as np

from ffsms_pin.checks import FloatArray

__all__ = ["entropies", "singular_values"]

# Squares are kept above this, the largest entry of a matrix being one: nothing is divided by zero.
_LEAST = 1e-36
# An off-diagonal square below this share of the diagonals beside it moves no digit of the square root.
_NEGLIGIBLE = 1e-30
# Of the bound that is a shift: short of it by more than rounding, so that every number stays positive.
_SHORT = 1.0 - 1e-8
# Of a sum of some twenty positive terms, with room.
_ROUNDING = 1e-13
# Sweeps for one singular value. Three to six are usual, since the shift converges with order three.
_SWEEPS = 40


def singular_values(matrices: FloatArray) -> FloatArray:
    """Singular values of a stack of matrices, the largest first.

    Parameters
    ----------
    matrices : ndarray, shape (m, n, B)
        Components first, the stack last; finite.

    Returns
    -------
    ndarray, shape (min(m, n), B)
        To 1e-14 of the largest of each matrix; usually to 1e-15.
    """
    A = matrices if matrices.shape[0] >= matrices.shape[1] else matrices.swapaxes(0, 1)
    size = np.abs(A).max(axis=(0, 1))
    q, e = _bidiagonal(A / np.where(size > 0.0, size, 1.0))
    squares = _squares(q, e)
    sigma = np.sqrt(np.maximum(squares, 0.0))
    sigma *= size
    sigma[::-1].sort(axis=0)
    return sigma


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


def _bidiagonal(A: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Squares of the diagonal (n, B) and of the superdiagonal (n - 1, B) of bidiagonal matrices.

    They have the singular values of A (m, n, B), which is overwritten. Signs do not matter for singular
    values, so the squares are all there is to keep.
    """
    n, count = A.shape[1:]
    q, e = np.empty((n, count)), np.empty((n - 1, count))
    for j in range(n):
        q[j] = _reflect(A[j:, j], A[j:, j + 1 :])
        if j + 1 < n:
            e[j] = _reflect(A[j, j + 1 :], A[j + 1 :, j + 1 :].swapaxes(0, 1))
    return q, e


def _reflect(x: FloatArray, rest: FloatArray) -> FloatArray:
    """Reflect vectors x (k, B) onto their first axis, and the columns of rest (k, l, B) with them; |x|^2."""
    square: FloatArray = np.einsum("kb,kb->b", x, x)
    if len(x) > 1 and rest.shape[1] > 0:
        norm = np.sqrt(square)
        v = x.copy()
        v[0] += np.copysign(norm, x[0])
        # v^T v / 2; where x is zero, so is v.
        half = square + norm * np.abs(x[0])
        scaled = v / np.where(half > 0.0, half, 1.0)
        rest -= v[:, None] * np.einsum("kb,klb->lb", scaled, rest)
    return square


def _squares(q: FloatArray, e: FloatArray) -> FloatArray:
    """Squares (n, B) of the singular values of bidiagonal matrices, in no order; q and e are overwritten."""
    np.maximum(q, _LEAST, out=q)
    # Rows that stand alone too: else the least square, where it is not in the last row, never gets there.
    np.maximum(e, _LEAST, out=e)
    shift = np.zeros(q.shape[1])
    for last in range(len(q) - 1, 0, -1):
        _loosen(q[: last + 1], e[:last], shift)
        # The last row has come loose: its diagonal is a square, less the shift.
        q[last] += shift
    q[0] += shift
    return q


def _loosen(q: FloatArray, e: FloatArray, shift: FloatArray) -> None:
    """Sweep until the last row of every matrix stands alone, in place."""
    for _ in range(_SWEEPS):
        left = np.flatnonzero(e[-1] > _NEGLIGIBLE * (q[-1] + shift) + 4.0 * _LEAST)
        if len(left) == 0:
            return
        if 2 * len(left) < len(shift):
            few = q[:, left], e[:, left], shift[left]
            _loosen(*few)
            q[:, left], e[:, left], shift[left] = few
            return
        step = _SHORT * _laguerre(q, e)
        _sweep(q, e, step)
        shift += step


def _sweep(q: FloatArray, e: FloatArray, shift: FloatArray) -> None:
    """One sweep of the differential qd algorithm with shifts [dqds], in place."""
    d = np.maximum(q[0] - shift, _LEAST)
    for i in range(len(e)):
        q[i] = d + e[i]
        ratio = q[i + 1] / q[i]
        e[i] = np.maximum(e[i] * ratio, _LEAST)
        d = np.maximum(d * ratio - shift, _LEAST)
    q[-1] = d


def _laguerre(q: FloatArray, e: FloatArray) -> FloatArray:
    """A lower bound (B,) of the least square, by the traces of the inverse and of its square."""
    k = len(q)
    inverse = 1.0 / q
    u, w = 1.0, 0.0
    first, second = inverse[0].copy(), inverse[0] ** 2
    for i in range(k - 1):
        grow = e[i] * inverse[i]
        w = grow * (w + 2.0 * u * u * inverse[i])
        u = 1.0 + grow * u
        g = u * inverse[i + 1]
        first += g
        second += g * g + w * inverse[i + 1]
    # Where all squares are nearly equal the difference is rounding, and must not make the bound too large.
    spread = (k - 1) * np.maximum(k * second - first * first, _ROUNDING * second)
    return np.asarray(k / (first + np.sqrt(spread)))
