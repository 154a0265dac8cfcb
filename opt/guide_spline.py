"""The cubic spline that a guide is, its ends clamped."""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray

__all__ = ["basis", "head"]


def basis(count: int, derivative: int, at: FloatArray) -> FloatArray:
    """Cubic B-splines on [0, 1] with ends clamped, or their derivatives, at some places (places, count)."""
    inner = np.arange(1.0, count - 3) / (count - 3)
    knots = np.concatenate([np.zeros(4), inner, np.ones(4)])
    degree = 3 - derivative
    # Recursion of Cox and de Boor; the last span holds the end as well.
    span = np.clip(np.searchsorted(knots, at, side="right") - 1, 3, count - 1)
    values = np.zeros((len(at), count + 3))
    values[np.arange(len(at)), span] = 1.0
    for d in range(1, degree + 1):
        width = knots[d:] - knots[:-d]
        share = np.divide(1.0, width, out=np.zeros_like(width), where=width > 0.0)
        left = (at[:, None] - knots[: -d - 1]) * share[:-1]
        right = (knots[d + 1 :] - at[:, None]) * share[1:]
        m = len(knots) - d - 1
        values = left[:, :m] * values[:, :m] + right[:, :m] * values[:, 1 : m + 1]
    for d in range(degree + 1, 4):
        width = knots[d:] - knots[:-d]
        share = np.divide(d, width, out=np.zeros_like(width), where=width > 0.0)
        m = len(knots) - d - 1
        values = share[:m] * values[:, :m] - share[1 : m + 1] * values[:, 1 : m + 1]
    return values


def head(positions: FloatArray, rates: FloatArray, count: int, duration: float) -> FloatArray:
    """The first two control points, which say where the motion starts and how fast."""
    return np.array([positions, positions + rates * duration / (3.0 * (count - 3))])
