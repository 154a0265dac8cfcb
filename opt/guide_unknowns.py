"""The unknowns of a guide: the control points that are left free, of the joints that can move."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.guide_spline import basis, head, maps

__all__ = ["Unknowns"]


class Unknowns:
    """Free control points, flattened with the joints last, as x (k,).

    Parameters
    ----------
    positions, rates : ndarray, shape (n,)
        Where the guide starts, and how fast [rad], [rad/s].
    duration : float
        [s]
    fixed : ndarray of bool, shape (n,), or None
        Joints that cannot be moved.

    Attributes
    ----------
    joints : ndarray of int
        Those that can be moved.
    positions, rates, accelerations, dense : ndarray
        Maps from all control points (K, n), as in `Maps`, but over time [s].
    free : ndarray, shape (K, rows)
        Map from the free rows of control points to all of them.
    """

    def __init__(
        self, positions: FloatArray, rates: FloatArray, duration: float, fixed: NDArray[np.bool_] | None
    ) -> None:
        self._count = 10 if duration > 3.0 else 7
        self._begin = head(positions, rates, self._count, duration)
        self.joints = np.flatnonzero(np.ones(len(positions), dtype=bool) if fixed is None else ~fixed)
        made = maps(self._count)
        self.free, self.dense = made.free, made.dense
        self.positions = made.positions
        self.rates = made.rates / duration
        self.accelerations = made.accelerations / duration**2

    def points(self, x: FloatArray) -> FloatArray:
        """All control points (K, n)."""
        rows = self.free.shape[1]
        P = np.tile(self._begin[1], (rows, 1))
        P[:, self.joints] = x.reshape(rows, -1)
        return np.vstack([self._begin, P, P[-1:]])

    def slopes(self, B: FloatArray, gradients: FloatArray) -> FloatArray:
        """Slopes (m, k) of values with gradients (m, n) by the joints where the maps B (m, K) lead."""
        inner = B @ self.free
        made: FloatArray = inner[:, :, None] * gradients[:, None, self.joints]
        return made.reshape(len(B), inner.shape[1] * len(self.joints))

    def summed(self, B: FloatArray, gradients: FloatArray) -> FloatArray:
        """Slopes (m, k) of values with gradients (S, m, n) by the joints at each of the places B (S, K)."""
        made: FloatArray = np.einsum("smj,sk->mkj", gradients[:, :, self.joints], B @ self.free)
        return made.reshape(gradients.shape[1], -1)

    def nearest(self, way: FloatArray) -> FloatArray:
        """Unknowns of the spline nearest to joint positions (m, n) at even instants, that ends as they do.

        Of one that is nearly right already hardly anything has to change.
        """
        B = basis(self._count, 0, np.linspace(0.0, 1.0, len(way)))
        ends = np.vstack([self._begin, way[-1], way[-1]])
        inside = np.linalg.lstsq(B[:, 2:-2], way - B[:, [0, 1, -2, -1]] @ ends, rcond=None)[0]
        nearest: FloatArray = np.vstack([inside, way[-1:]])[:, self.joints]
        return nearest.ravel()
