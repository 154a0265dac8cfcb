"""A residual whose square is the size of a number, smooth at zero."""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray

__all__ = ["smooth_size"]


def smooth_size(x: FloatArray, rounding: float) -> tuple[FloatArray, FloatArray]:
    """Values r with r^2 = sqrt(x^2 + e^2) - e, which is |x| less at most e, and dr/dx.

    Least squares take squares, and the integral of |x| has a kink at zero. With s = sqrt(x^2 + e^2) it is
    (s - e)(s + e) = x^2, so r = x / sqrt(s + e) is smooth, and its slope is sqrt(s + e) / (2 s).

    Parameters
    ----------
    x : ndarray
    rounding : float
        e > 0, in the unit of x: below it the square of r is like x^2 / (2 e).
    """
    s = np.sqrt(x * x + rounding * rounding)
    root = np.sqrt(s + rounding)
    return x / root, 0.5 * root / s
