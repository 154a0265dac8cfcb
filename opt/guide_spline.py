"""The cubic spline that a guide is, its ends clamped, and the maps from its control points.

Places are shares of the guide's time: rates are to be divided by its duration, accelerations by the square.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray

__all__ = ["NODES", "Maps", "basis", "head", "maps", "spline"]

# Samples of the roll-out: two Gauss points a panel. Samples at the middles of equal spans would put the end
# of a motion of 12 s off by millimetres.
_SAMPLES = 32
_GAUSS = (0.5 - np.sqrt(3.0) / 6.0, 0.5 + np.sqrt(3.0) / 6.0)
NODES = np.array([(panel + place) * 2.0 / _SAMPLES for panel in range(_SAMPLES // 2) for place in _GAUSS])


class Maps(NamedTuple):
    """What control points (K, n) have to be multiplied by.

    Attributes
    ----------
    positions, rates : ndarray, shape (S, K)
        At `NODES`.
    accelerations : ndarray, shape (K - 2, K)
        At the knots: between two of them the acceleration is linear, so there it is largest.
    dense : ndarray, shape (2 S + 1, K)
        Positions at evenly spaced places.
    free : ndarray, shape (K, K - 3)
        Control points that the start leaves free. The last of them is there twice: at rest at the end.
    """

    positions: FloatArray
    rates: FloatArray
    accelerations: FloatArray
    dense: FloatArray
    free: FloatArray


@lru_cache
def maps(count: int) -> Maps:
    """The maps for K = `count` control points."""
    free = np.zeros((count, count - 3))
    free[2 : count - 1] = np.eye(count - 3)
    free[-1, -1] = 1.0
    made = Maps(
        positions=basis(count, 0, NODES),
        rates=basis(count, 1, NODES),
        accelerations=basis(count, 2, np.linspace(0.0, 1.0, count - 2)),
        dense=basis(count, 0, np.linspace(0.0, 1.0, 2 * _SAMPLES + 1)),
        free=free,
    )
    for array in made:
        array.setflags(write=False)
    return made


def spline(points: FloatArray) -> Any:
    """The scipy.interpolate.BSpline on [0, 1] with these control points (K, n)."""
    from scipy.interpolate import BSpline  # slow to load

    inner = np.arange(1.0, len(points) - 3) / (len(points) - 3)
    return BSpline(np.concatenate([np.zeros(4), inner, np.ones(4)]), points, 3)


def basis(count: int, derivative: int, at: FloatArray) -> FloatArray:
    """The `count` splines that are made of one control point each, or their derivatives: (places, count)."""
    return np.asarray(_units(count)(at, nu=derivative))


@lru_cache
def _units(count: int) -> Any:
    return spline(np.eye(count))


def head(positions: FloatArray, rates: FloatArray, count: int, duration: float) -> FloatArray:
    """The first two control points, which say where the motion starts and how fast."""
    return np.array([positions, positions + rates * duration / (3.0 * (count - 3))])
