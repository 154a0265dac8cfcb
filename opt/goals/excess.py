"""How far vectors are longer than allowed, as residuals: for limits on a place or an attitude."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.batch.orientation import orientation_residual
from ffsms_pin.opt.batch.residual import Indices

__all__ = ["Excess", "excess", "turn_excess"]


class Excess(NamedTuple):
    """Residuals of what vectors have beyond an allowed length; those that have nothing are left out.

    Of each vector there are four: its excess; and, for the second derivatives, three that are zero, with
    slopes across the vector. The squares of the four have the same slopes, and the same second derivatives by
    Gauss and Newton, as those of the three components of the shortened vector.

    Attributes
    ----------
    value : ndarray, shape (W,)
    slope : ndarray, shape (3, W)
        By the vector; of `turn_excess`, by a turn of the frame.
    entry : ndarray of int, shape (W,)
        Which vector.
    """

    value: FloatArray
    slope: FloatArray
    entry: Indices


def excess(vectors: FloatArray, allowed: float) -> Excess:
    """Of vectors (3, V)."""
    length = np.linalg.norm(vectors, axis=0)
    kept = np.flatnonzero(length > allowed)
    unit = vectors[:, kept] / np.maximum(length[kept], 1e-12)
    short = length[kept] - allowed
    share = short / np.maximum(length[kept], 1e-12)
    across = share * (np.eye(3)[..., None] - unit[:, None] * unit)  # (3, 3, V), symmetric
    value = np.concatenate([short, np.zeros(3 * len(kept))])
    slope = np.concatenate([unit, across[:, 0], across[:, 1], across[:, 2]], axis=1)
    return Excess(value, slope, np.tile(kept, 4))


def turn_excess(wanted: FloatArray, attitude: FloatArray, allowed: float) -> Excess:
    """Of the turns from attitudes (3, 3, V) to the wanted ones, with slopes by a turn of the frame."""
    turns, by_turn, _ = orientation_residual(wanted, attitude, 0.0)
    found = excess(turns, allowed)
    slope = np.einsum("xw,xyw->yw", found.slope, by_turn[..., found.entry])
    return found._replace(slope=slope)
