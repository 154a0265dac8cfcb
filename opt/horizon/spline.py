"""The joint rates of a motion as one quadratic B-spline a joint.

Its acceleration is a linear spline and its position a cubic one, each with control points that are linear in
those of the rates. A spline lies within the range of its control points, so rows on these keep the rate,
acceleration and position limits at every instant.

Reference: C. de Boor, "A Practical Guide to Splines", 2001, ch. IX to XI.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.trajectory import ARRIVAL_SHARE

__all__ = ["RateSpline", "at_nodes", "embedding", "rate_spline"]


@dataclass(frozen=True, eq=False)
class RateSpline:
    """Knots, quadrature points and the linear maps from control points (M, n); the first and last are zero.

    Attributes
    ----------
    knots : ndarray
        With their repetitions; the last lies half a step beyond the deadline (see `rate_spline`).
    rates, travel : ndarray, shape (Q + 2, M)
        Joint rates and their integral at Q quadrature points, then at 0.9 T and T.
    times : ndarray, shape (Q + 2,)
    weights : ndarray, shape (Q,)
        Of the quadrature over time.
    part : ndarray, shape (m, g, g)
        Integration from an interval's start to its g points.
    whole : ndarray, shape (m, g)
        Integration over the interval.
    sweep : ndarray, shape (Q + 2, Q)
        Integration from the start to every point.
    late : int
        The interval that begins at 0.9 T.
    acceleration : ndarray, shape (M + 1, M)
        To the control points of the accelerations.
    position : ndarray, shape (M, M)
        To the control points of the positions, relative to the start.
    last_rate : ndarray, shape (M,)
        Joint rates at T.
    roughness : ndarray, shape (M, M)
        p^T roughness p is the integral of the squared acceleration.
    sites, at_sites : ndarray, shape (M,), (M, M)
        The control points' places in time, and the rates there: for collocation.
    """

    knots: FloatArray
    rates: FloatArray
    travel: FloatArray
    times: FloatArray
    weights: FloatArray
    part: FloatArray
    whole: FloatArray
    sweep: FloatArray
    late: int
    acceleration: FloatArray
    position: FloatArray
    last_rate: FloatArray
    roughness: FloatArray
    sites: FloatArray
    at_sites: FloatArray

    @property
    def size(self) -> int:
        """Number of control points that are free, M."""
        return int(self.rates.shape[1])

    @property
    def points(self) -> int:
        """Number of quadrature points, Q."""
        return len(self.weights)

    @cached_property
    def roots(self) -> FloatArray:
        """Square roots of the weights, and zeros for 0.9 T and T (Q + 2,)."""
        return np.append(np.sqrt(self.weights), [0.0, 0.0])

    @cached_property
    def last_tenth(self) -> NDArray[np.intp]:
        """Indices of the quadrature's points after 0.9 T, and of 0.9 T itself."""
        count = self.points
        return np.append(np.flatnonzero(self.times[:count] > self.times[count]), count)


@lru_cache(maxsize=32)
def rate_spline(steps: int, dt: float, intervals: int, late_intervals: int, gauss: int) -> RateSpline:
    """Make the spline for a duration of `steps` steps of `dt`.

    The rates end at zero half a step after the deadline: a stopped end effector has no direction, so at the
    last node, where the paper's cost is still summed, the arm must be just about to stop.

    Parameters
    ----------
    steps : int
    dt : float
        [s]
    intervals, late_intervals : int
        Before and after 0.9 T. The late ones halve in length: so does the distance that they handle.
    gauss : int
        Quadrature points an interval.
    """
    duration = steps * dt
    end, late_start = duration + 0.5 * dt, ARRIVAL_SHARE * duration
    main = np.linspace(0.0, late_start, intervals + 1)
    rest = end - (end - late_start) * 0.5 ** np.arange(1, late_intervals)
    rest = rest[rest <= duration - 0.5 * dt]  # the deadline lies in the last interval
    borders = np.concatenate([main, rest, [end]])
    knots = np.concatenate([[0.0] * 2, borders, [end] * 2])
    acceleration = _difference(knots)
    # The directions change fastest where the arm starts to move; there the cost is watched more closely.
    stops = np.concatenate([[0.0, 0.06 * main[1], 0.25 * main[1]], borders[1:-1], [duration]])
    late = intervals + 2

    x, w = np.polynomial.legendre.leggauss(gauss)
    nodes = 0.5 * (x + 1.0)
    powers = np.arange(1, gauss + 1)
    inner = (nodes[:, None] ** powers / powers) @ np.linalg.inv(np.vander(nodes, gauss, increasing=True))
    spans = np.diff(stops)
    times = np.concatenate([(stops[:-1, None] + spans[:, None] * nodes).ravel(), [late_start, duration]])
    whole, part = spans[:, None] * (0.5 * w), spans[:, None, None] * inner
    sweep = np.zeros((len(spans) * gauss + 2, len(spans) * gauss))
    for k in range(len(spans)):
        columns = slice(k * gauss, (k + 1) * gauss)
        sweep[columns, columns] = part[k]
        sweep[(k + 1) * gauss : -2, columns] = whole[k]
        sweep[-2, columns] = whole[k] if k < late else 0.0
        sweep[-1, columns] = whole[k]

    sites = (0.5 * (knots[1:-2] + knots[2:-1]))[1:-1]
    rates, travel = _maps(knots, times)
    left, right = acceleration[:-1], acceleration[1:]
    lengths = np.diff(borders)[:, None, None] / 6.0
    both = left[:, :, None] * right[:, None, :]
    squares = left[:, :, None] * left[:, None, :] + right[:, :, None] * right[:, None, :]
    roughness = np.sum(lengths * (2.0 * squares + both + np.swapaxes(both, 1, 2)), axis=0)
    return RateSpline(
        knots=knots,
        rates=rates,
        travel=travel,
        times=times,
        weights=whole.ravel(),
        part=part,
        whole=whole,
        sweep=sweep,
        late=late,
        acceleration=acceleration,
        position=_summation(knots)[:, 1:-1][1:-1],
        last_rate=rates[-1],
        roughness=roughness,
        sites=sites,
        at_sites=_basis(knots, 2, sites)[:, 1:-1],
    )


def at_nodes(spline: RateSpline, times: FloatArray) -> FloatArray:
    """Joint rates at any times (K,) as a map (K, M)."""
    return _basis(spline.knots, 2, times)[:, 1:-1]


@lru_cache(maxsize=32)
def embedding(coarse: RateSpline, fine: RateSpline) -> FloatArray:
    """Map from a coarse spline's control points to those of a fine one that agrees with it at its sites."""
    return np.asarray(np.linalg.solve(fine.at_sites, at_nodes(coarse, fine.sites)))


def _difference(knots: FloatArray) -> FloatArray:
    """Control points of the derivative of a quadratic spline whose outer control points are zero."""
    count = len(knots) - 3
    spans = knots[3 : 3 + count - 1] - knots[1:count]
    rows = np.arange(count - 1)
    matrix = np.zeros((count - 1, count))
    matrix[rows, rows], matrix[rows, rows + 1] = -2.0 / spans, 2.0 / spans
    return matrix[:, 1:-1]


def _summation(knots: FloatArray) -> FloatArray:
    """Control points of the integral of a quadratic spline."""
    count = len(knots) - 3
    return np.asarray(np.tril(np.ones((count, count))) * ((knots[3:] - knots[:-3]) / 3.0))


def _maps(knots: FloatArray, times: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rates and their integral at times, a control point; the outer two, zero, left out."""
    wide = np.concatenate([[knots[0]], knots, [knots[-1]]])
    return _basis(knots, 2, times)[:, 1:-1], _basis(wide, 3, times)[:, 1:] @ _summation(knots)[:, 1:-1]


def _basis(knots: FloatArray, degree: int, times: FloatArray) -> FloatArray:
    """Values (K, M) of all B-splines at times (K,)."""
    from scipy.interpolate import BSpline  # slow to load

    return np.asarray(BSpline(knots, np.eye(len(knots) - degree - 1), degree)(times))
