"""The paper's two measures of dynamic coupling: normalised entropy and coupling assistance."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, times, whole
from ffsms_pin.kernel import kernel

# A velocity below this fraction of |J| |rates| is rounding, not motion: it has no direction.
ROUNDING = 1e-14


def normalised_entropy(sigma: ArrayLike, n: int) -> float:
    """Normalised Shannon entropy of a spectrum of singular values (paper Eq. SVD_2).

    Parameters
    ----------
    sigma : array_like, shape (r,)
        Singular values of C_bm, none negative, r <= n; those beyond the rank count as zero.
    n : int
        Number of joints; the sum is divided by log n.

    Returns
    -------
    float
        H_norm in [0, 1]: 0 when one direction carries all the coupling, 1 when all carry the same.
        With 0 log 0 = 0; zero for n = 1 and where there is no coupling at all.
    """
    return entropy_of_values(times("sigma", sigma, "", math.inf).tolist(), whole("n", n, 1))


def entropy_of_values(values: Sequence[float], n: int) -> float:
    """The same, of plain numbers: for a handful of them Python is several times faster than array calls."""
    total = math.fsum(values)
    if n <= 1 or total <= 0.0:
        return 0.0
    entropy = 0.0
    for value in values:
        share = value / total
        if share > 0.0:
            entropy -= share * math.log(share)
    return min(1.0, max(0.0, entropy / math.log(n)))


def cosine(velocity: FloatArray, direction: FloatArray, scale: float = 0.0) -> float:
    """Cosine between a velocity and a direction; 0 where either vanishes.

    Parameters
    ----------
    velocity, direction : ndarray, shape (3,)
        In the same axes; neither need be of unit length.
    scale : float
        Size that the velocity's terms had before they were summed, |J| |rates| [m/s]: a velocity that is
        rounding of that size has no direction and gives 0.

    Returns
    -------
    float
        In [-1, 1].
    """
    return cosine_of_triples(velocity.tolist(), direction.tolist(), scale)


def cosine_of_triples(velocity: Sequence[float], direction: Sequence[float], scale: float = 0.0) -> float:
    """The same, of vectors given as three plain numbers each."""
    (a, b, c), (x, y, z) = velocity, direction
    # hypot neither overflows nor loses small numbers, so only directions matter.
    speed, distance = math.hypot(a, b, c), math.hypot(x, y, z)
    if speed == 0.0 or distance == 0.0 or speed <= ROUNDING * scale:
        return 0.0
    along = (a / speed) * (x / distance) + (b / speed) * (y / distance) + (c / speed) * (z / distance)
    return min(1.0, max(-1.0, along))


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
