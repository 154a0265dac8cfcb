"""The fastest time law along a joint path: forward and backward passes over a grid of shares of the path.

At the share s of the path, with q' = dq/ds, the joints have rates q' ds/dt and accelerations q' u + q'' x.
Here x is the square of ds/dt, and u = d^2 s/dt^2. Without momentum the joint torques of a free-floating robot
are linear in u and x, too. So each limit is a row a u + b x <= c, or a bound on x. A backward pass computes
the largest x from which the end can be reached. A forward pass then uses the largest u.

Reference: H. Pham, Q.-C. Pham, "A new approach to time-optimal path parameterization based on reachability
analysis", IEEE Transactions on Robotics 34 (2018).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.goals.curves import TimeLaw
from ffsms_pin.opt.limits.limit import SpeedBound
from ffsms_pin.opt.problem import Problem

_LEAST = 1e-12  # a smaller coefficient of u is taken as zero


class LimitRows(NamedTuple):
    """The rows a u + b x <= c of the limits at G points of a path, and the bounds 0 <= x <= `largest`."""

    shares: FloatArray  # (G,) of the path
    a: FloatArray  # (G, m)
    b: FloatArray  # (G, m)
    c: FloatArray  # (m,)
    largest: FloatArray  # (G,)


def limit_rows(shares: FloatArray, bounds: Sequence[SpeedBound], margin: float) -> LimitRows:
    """Return speed bounds at shares (G,) of a path as rows; each bound is multiplied by 1 - `margin`."""
    use, a, b, c, fastest = 1.0 - margin, [], [], [], np.full(len(shares), np.inf)
    for bound in bounds:
        slack = use * bound.most[:, None] - np.sign(bound.slope) * bound.at_rest[:, None]
        fastest = np.minimum(fastest, (slack / np.maximum(np.abs(bound.slope), 1e-12)).min(axis=0))
        finite = np.isfinite(bound.most_change)
        slope = bound.slope[finite]
        bend = np.gradient(slope, shares, axis=1, edge_order=2) if bound.bend is None else bound.bend[finite]
        a += [slope, -slope]
        b += [bend, -bend]
        c += [use * bound.most_change[finite]] * 2
    largest = np.clip(fastest, 0.0, 1e3) ** 2
    return LimitRows(shares, np.vstack(a).T, np.vstack(b).T, np.concatenate(c), largest)


def fastest_law(rows: LimitRows) -> TimeLaw | None:
    """Return the time law of least time from rest to rest; None if the limits cannot be satisfied."""
    count = len(rows.shares)
    steps = np.diff(rows.shares)
    reachable = np.zeros(count)  # the largest x from which the end of the path can be reached at rest
    for i in range(count - 2, -1, -1):
        A, B, C = _stretch(rows, i, steps[i])
        # At the end of the interval 0 <= x + 2 step u <= reachable[i + 1].
        A = np.append(A, [2.0 * steps[i], -2.0 * steps[i]])
        B = np.append(B, [1.0, -1.0])
        C = np.append(C, [reachable[i + 1], 0.0])
        largest = _largest_x(A, B, C, rows.largest[i])
        if largest is None:
            return None
        reachable[i] = largest
    x, times = np.zeros(count), np.zeros(count)
    for i in range(count - 1):
        A, B, C = _stretch(rows, i, steps[i])
        A, B, C = np.append(A, 2.0 * steps[i]), np.append(B, 1.0), np.append(C, reachable[i + 1])
        up = A > _LEAST
        u = float(np.min((C[up] - B[up] * x[i]) / A[up]))
        x[i + 1] = min(max(x[i] + 2.0 * steps[i] * u, 0.0), reachable[i + 1])
        speeds = np.sqrt(x[i]) + np.sqrt(x[i + 1])
        if speeds <= 0.0:
            return None
        times[i + 1] = times[i] + 2.0 * steps[i] / speeds
    return TimeLaw(times, rows.shares, np.sqrt(x))


def _stretch(rows: LimitRows, i: int, step: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the rows at both ends of interval i, in its constant u and in x at its start."""
    ahead = rows.a[i + 1] + 2.0 * step * rows.b[i + 1]  # x at the end is x + 2 step u
    return (
        np.concatenate([rows.a[i], ahead]),
        np.concatenate([rows.b[i], rows.b[i + 1]]),
        np.concatenate([rows.c, rows.c]),
    )


def _largest_x(a: FloatArray, b: FloatArray, c: FloatArray, most: float) -> float | None:
    """Return the largest x in [0, most] for which a u exists with a u + b x <= c; None if there is none.

    Rows with a > 0 are upper bounds (c - b x) / a of u, and rows with a < 0 are lower bounds. A feasible u
    exists if each lower bound is at most each upper bound. These conditions contain only x.
    """
    up, down = a > _LEAST, a < -_LEAST
    none = ~up & ~down
    level_up, slope_up = c[up] / a[up], -b[up] / a[up]
    level_down, slope_down = c[down] / a[down], -b[down] / a[down]
    # level_down + slope_down x <= level_up + slope_up x
    slope = np.concatenate([(slope_down[:, None] - slope_up).ravel(), b[none]])
    level = np.concatenate([(level_up - level_down[:, None]).ravel(), c[none]])
    rising, falling = slope > 1e-12, slope < -1e-12
    high = min(float(np.min(level[rising] / slope[rising], initial=np.inf)), most)
    low = max(float(np.max(level[falling] / slope[falling], initial=-np.inf)), 0.0)
    if (level[~rising & ~falling] < -1e-9).any() or low > high + 1e-9:
        return None
    return max(high, 0.0)


def check_timing(problem: Problem) -> None:
    """Raise `InvalidValue` if the joint motion along a path depends on the speed."""
    path = problem.goal
    if problem.momentum is not None or problem.joint_rates.any():
        remedy = (
            'can be "fastest" only if the robot starts at rest, without momentum; else set timing="given"'
        )
        raise InvalidValue("timing", path.timing, remedy)


def check_bounded(problem: Problem, bounds: Sequence[SpeedBound]) -> None:
    """Raise `InvalidValue` if no limit bounds the acceleration along a path, so that no least time exists."""
    if not any(np.isfinite(bound.most_change).any() for bound in bounds):
        remedy = 'must include opt.JointLimits or opt.TorqueLimits if the path has timing="fastest"'
        raise InvalidValue("limits", [limit.name for limit in problem.limits], remedy)
