"""The joint rates of a motion as one quadratic B-spline per joint.

The acceleration is then a linear spline, and the position a cubic spline. A spline lies within the range of
its control points, so bounds on control points ensure the limits at every instant. The first control point is
the joint's initial rate. The last control point is zero, or free if the joints may move at the end.

Reference: C. de Boor, "A Practical Guide to Splines", 2001, ch. IX to XI.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray, frozen
from ffsms_pin.opt.rollouts import ARRIVAL_SHARE


class Grid(NamedTuple):
    """The resolution of a spline: the intervals before and after 0.9 T, and Gauss points in each interval.

    Late intervals halve in length towards the end, because the distance to the goal decreases in a similar
    way; the last two are equal. There are fewer of them if they would be shorter than a time step.
    """

    intervals: int
    late: int
    gauss: int


# Splines with up to 9 and up to 17 free control points per joint, and with one more if the rates at the end
# are free. Nine suffice for a motion that reverses twice.
COARSE, FINE = Grid(6, 3, 2), Grid(12, 5, 3)


class Map(NamedTuple):
    """A linear map from a joint's free control points p (M,) to values (k,).

    The values are free @ p + fixed * rate, with free (k, M), fixed (k,) and the joint's rate at the start.
    If the spline is the change of a motion (`RateSpline.around`), `fixed` (k, n) has the values of the
    motion, and the result is free @ p + fixed.
    """

    free: FloatArray
    fixed: FloatArray

    def given(self, rates0: FloatArray) -> FloatArray:
        """Return the values (k, n) for zero control points and joint rates (n,) at the start."""
        return self.fixed[:, None] * rates0 if self.fixed.ndim == 1 else self.fixed

    def of(self, p: FloatArray, rates0: FloatArray) -> FloatArray:
        """Return the values (..., k, n) for control points (..., M, n) and joint rates (n,) at the start."""
        return np.asarray(self.free @ p + self.given(rates0))


@dataclass(frozen=True, eq=False)
class RateSpline:
    """The knots and instants of a spline, and linear maps from its control points.

    `times` (Q + 2,) are Q quadrature points, then 0.9 T and T. `rates`, `travel` and `accelerations` map to
    the joint rates, their integrals and their derivatives at these times. `weights` (Q + 2,) are the
    quadrature weights of integrals over time, with the weight of the last step at T. In `limit_weights`, for
    limits, 0.9 T and T each have the weight of the whole time. `last_tenth` are the indices of times from
    0.9 T on, except T. `quadrature` is for the kernel, with m intervals of g points each. It has the weights
    (m, g, g) of integrals from the start of an interval to its points, the weights (m, g) of integrals over
    an interval, and the index of the interval that begins at 0.9 T.
    `acceleration_points`, `position_points` and `rate_points` map to the control points of accelerations,
    displacements from the start, and rates. p^T `squared_acceleration` p is the integral of the squared
    acceleration of a motion from rest. `sites` (M,) are the times of the free control points, and `at_sites`
    maps to the rates there. `free_end` is true if the rates at the end are free, and `changes` if the spline
    is the change of another motion (`around`).
    """

    knots: FloatArray
    rates: Map
    travel: Map
    accelerations: Map
    times: FloatArray
    weights: FloatArray
    limit_weights: FloatArray
    last_tenth: NDArray[np.intp]
    quadrature: tuple[FloatArray, FloatArray, int]
    acceleration_points: Map
    position_points: Map
    rate_points: Map
    squared_acceleration: FloatArray
    sites: FloatArray
    at_sites: Map
    free_end: bool
    changes: bool = False

    @property
    def size(self) -> int:
        """The number of free control points, M."""
        return int(self.rates.free.shape[1])

    @cached_property
    def maps(self) -> FloatArray:
        """The matrices from control points to travel, rates and accelerations (3, Q + 2, M)."""
        return np.stack([self.travel.free, self.rates.free, self.accelerations.free])

    def around(self, dt: float, rates: FloatArray) -> RateSpline:
        """Return the spline of changes of a motion with joint rates (N + 1, n) at nodes `dt` [s] apart.

        The rates of the motion are linear between nodes. A change begins with zero rate and acceleration, and
        is zero if all control points are zero. The maps to the control points of accelerations,
        displacements and rates are for limits. Their `fixed` (2, k, n) has the least and greatest values of
        the motion on the support of each control point.
        """
        slopes = np.diff(rates, axis=0) / dt
        places = np.vstack([np.zeros_like(rates[:1]), np.cumsum(0.5 * dt * (rates[1:] + rates[:-1]), axis=0)])
        k = np.clip((self.times / dt + 1e-9).astype(int), 0, len(slopes) - 1)
        h, slope = (self.times - k * dt)[:, None], slopes[k]

        def changed(of: Map, offset: FloatArray) -> Map:
            return Map(np.ascontiguousarray(of.free[:, 1:]), offset)

        def ranged(of: Map, values: FloatArray, first: int, knots: int) -> Map:
            begin = first + np.arange(len(of.free))
            stretch = np.stack(
                [self.knots[begin], self.knots[np.minimum(begin + knots, len(self.knots) - 1)]]
            )
            low, high = np.floor(stretch[0] / dt + 1e-9), np.ceil(stretch[1] / dt - 1e-9) + 1
            most = len(values)
            pairs = np.stack([np.minimum(low, most - 1), np.minimum(high, most)], axis=1).astype(int).ravel()
            values = np.vstack([values, values[-1:]])
            ends = [function.reduceat(values, pairs, axis=0)[::2] for function in (np.minimum, np.maximum)]
            return changed(of, np.stack(ends))

        return replace(
            self,
            rates=changed(self.rates, rates[k] + h * slope),
            travel=changed(self.travel, places[k] + h * (rates[k] + 0.5 * h * slope)),
            accelerations=changed(self.accelerations, slope),
            acceleration_points=ranged(self.acceleration_points, slopes, 1, 2),
            position_points=ranged(self.position_points, places, 0, 4),
            rate_points=ranged(self.rate_points, rates, 1, 3),
            sites=self.sites[1:],
            changes=True,
        )

    def rates_at(self, times: FloatArray) -> Map:
        """Return the map to the joint rates at times (k,)."""
        return _cut(_basis(self.knots, 2, times), self.free_end)

    def through(self, rates: FloatArray, rates0: FloatArray) -> FloatArray:
        """Return control points (..., M, n) for rates (..., M, n) at the sites and rates0 (n,) at time 0."""
        change = rates - self.at_sites.fixed[:, None] * rates0
        return np.asarray(np.linalg.solve(self.at_sites.free, change))

    def nearest(self, times: FloatArray, rates: FloatArray, rates0: FloatArray) -> FloatArray:
        """Return control points (..., M, n) whose rates at times (k,) are nearest to `rates` (..., k, n)."""
        maps = self.rates_at(times)
        return np.asarray(np.linalg.pinv(maps.free) @ (rates - maps.fixed[:, None] * rates0))


@lru_cache(maxsize=64)
def gauss(points: int) -> tuple[FloatArray, FloatArray]:
    """Return the Gauss points and weights for the interval from 0 to 1."""
    x, w = np.polynomial.legendre.leggauss(points)
    return frozen(0.5 * (x + 1.0)), frozen(0.5 * w)


@lru_cache(maxsize=64)
def rate_spline(steps: int, dt: float, grid: Grid, free_end: bool = False) -> RateSpline:
    """Return the spline for `steps` steps of `dt` [s].

    The rates reach zero half a step after the deadline, or are free if `free_end`. The paper's cost includes
    the last node, so at this node the arm must still move.
    """
    duration = steps * dt
    end, late_start = duration + 0.5 * dt, ARRIVAL_SHARE * duration
    main = np.linspace(0.0, late_start, grid.intervals + 1)
    rest = end - (end - late_start) * 0.5 ** np.arange(1, grid.late)
    rest = rest[rest <= duration - 0.5 * dt]  # the deadline lies in the last interval
    borders = np.concatenate([main, rest, [end]])
    knots = np.concatenate([[0.0] * 2, borders, [end] * 2])
    # The direction of motion changes fastest at the start, so more samples of the cost lie near the start.
    stops = np.concatenate([[0.0, 0.06 * main[1], 0.25 * main[1]], borders[1:-1], [duration]])
    last_step = duration - dt if steps > 10 else duration  # short motions have no separate last step
    if np.abs(stops - last_step).min() > 0.1 * dt:
        stops = np.sort(np.append(stops, last_step))

    nodes, shares = gauss(grid.gauss)
    powers = np.arange(1, grid.gauss + 1)
    inner = (nodes[:, None] ** powers / powers) @ np.linalg.inv(np.vander(nodes, increasing=True))
    spans = np.diff(stops)
    times = np.concatenate([(stops[:-1, None] + spans[:, None] * nodes).ravel(), [late_start, duration]])
    whole, part = spans[:, None] * shares, spans[:, None, None] * inner
    late = grid.intervals + 2

    count = len(knots) - 3
    # Control points of the derivative, a linear spline, and of the integral, a cubic spline (de Boor, X).
    slope = 2.0 * np.diff(np.eye(count), axis=0) / (knots[3:-1] - knots[1:-3])[:, None]
    integral = np.tril(np.tile((knots[3:] - knots[:-3]) / 3.0, (count + 1, 1)), -1)
    inner_knots, more_knots = knots[1:-1], np.concatenate([knots[:1], knots, knots[-1:]])
    accelerations = _cut(slope, free_end)
    left, right = accelerations.free[:-1], accelerations.free[1:]
    lengths = np.diff(borders)[:, None, None] / 6.0
    both = left[:, :, None] * right[:, None, :]
    squares = left[:, :, None] * left[:, None, :] + right[:, :, None] * right[:, None, :]
    sites = (0.5 * (knots[1:-2] + knots[2:-1]))[1 : None if free_end else -1]
    return RateSpline(
        knots=knots,
        rates=_cut(_basis(knots, 2, times), free_end),
        travel=_cut(_basis(more_knots, 3, times) @ integral, free_end),
        accelerations=_cut(_basis(inner_knots, 1, times) @ slope, free_end),
        times=times,
        weights=_weights(whole, times < last_step),
        limit_weights=np.append(whole, [duration, duration]),
        last_tenth=np.arange(late * grid.gauss, whole.size + 1),
        quadrature=(part, whole, late),
        acceleration_points=accelerations,
        position_points=_cut(integral[1:], free_end),
        rate_points=_cut(np.eye(count)[1 : None if free_end else -1], free_end),
        squared_acceleration=np.sum(lengths * (2.0 * squares + both + np.swapaxes(both, 1, 2)), axis=0),
        sites=sites,
        at_sites=_cut(_basis(knots, 2, sites), free_end),
        free_end=free_end,
    )


def _weights(whole: FloatArray, early: NDArray[np.bool_]) -> FloatArray:
    """Return the weights (Q + 2,) of integrals over time, with the weight of the last step at the deadline.

    The paper's cost is a sum over the steps. In the last step the direction to the goal rotates fast, so the
    integral over this step would differ from its summand.
    """
    over, soon = whole.ravel(), early[:-2]
    return np.append(np.where(soon, over, 0.0), [0.0, over[~soon].sum()])


def embedded(coarse: RateSpline, fine: RateSpline, p: FloatArray, rates0: FloatArray) -> FloatArray:
    """Return control points (..., M, n) of the fine spline that equals the coarse one at `fine.sites`."""
    return fine.through(coarse.rates_at(fine.sites).of(p, rates0), rates0)


def _cut(columns: FloatArray, free_end: bool) -> Map:
    """Return the map for a matrix (k, count) of all control points, split into fixed and free columns."""
    return Map(np.ascontiguousarray(columns[:, 1 : None if free_end else -1]), columns[:, 0])


def _basis(knots: FloatArray, degree: int, times: FloatArray) -> FloatArray:
    """Return the values (k, count) of all B-splines of a degree at times (k,), by the recursion of de Boor.

    `scipy.interpolate.BSpline` returns the same values, but its import is slow.
    """
    last = len(knots) - degree - 2  # the last interval that is not empty
    interval = np.clip(np.searchsorted(knots, times, side="right") - 1, degree, last)
    basis: FloatArray = (interval[:, None] == np.arange(len(knots) - 1)).astype(np.float64)
    t = np.asarray(times)[:, None]
    for k in range(1, degree + 1):
        width = knots[k:] - knots[:-k]
        share = np.divide(t - knots[:-k], width, out=np.zeros((len(t), len(width))), where=width > 0.0)
        basis = share[:, :-1] * basis[:, :-1] + (1.0 - share[:, 1:]) * basis[:, 1:]
    return basis
