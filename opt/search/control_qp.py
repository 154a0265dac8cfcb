"""The quadratic program (QP) of a descent step: a quadratic model of the merit under linear limits.

If the unconstrained minimum satisfies the limits, a Cholesky factorisation solves the QP, otherwise DAQP.
DAQP is a dual active-set solver. It is deterministic, and fast for a few dozen unknowns.

Reference: D. Arnstroem, A. Bemporad, D. Axehill, "A dual active-set solver for embedded quadratic programming
using recursive LDL^T updates", IEEE Transactions on Automatic Control 67 (2022).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import daqp
import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.evaluation import UNBOUNDED
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.search.inverse_kinematics import at_rest, braking, within_workspace
from ffsms_pin.opt.search.spline import Map, RateSpline
from ffsms_pin.system import RobotLimits

# The tolerance of DAQP. Bounds have a margin of 10 times the tolerance. Rows within 100 times the
# tolerance of a bound are in the initial active set.
_TOLERANCE = 1e-7
_LEAST_STOP = 0.5  # [s] least value that `_slowing` uses for the longest braking time of the joints


class _Rows(NamedTuple):
    """The rows lower <= matrix p_j <= upper of one kind, for the control points p_j (M,) of every joint j.

    `matrix` is (k, M), and the bounds are (k, n).
    """

    kind: str
    matrix: FloatArray
    lower: FloatArray
    upper: FloatArray


class ControlQP:
    """The QP for a step x from control points p, with the limits lower <= rows (p + x) <= upper.

    The control points (M n,) are flattened with the joints as the last axis. `matrix` (k, M) has the rows of
    one joint, which are the same for all joints. `kinds` (k,) has the kind of each row: "rate",
    "acceleration", "position", "rest" (at the end) or "stop" (after the end). The first `moving` rows of the
    QP have the first three kinds. Bounds are widened so that zero control points are feasible if
    `RateSpline.changes`, and otherwise those of an arm that brakes from the start.
    """

    def __init__(self, problem: Problem, spline: RateSpline) -> None:
        n, size = problem.sms.n, spline.size
        self._size, self._free = size * n, np.flatnonzero(np.tile(problem.free, size))
        kinds = [_Rows("", np.empty((0, size)), *np.empty((2, 0, n))), *_rows(problem, spline)]
        self.matrix = np.vstack([kind.matrix for kind in kinds])
        each = np.zeros((len(self.matrix), n, size, n))  # (row, joint, control point, joint)
        each[:, np.arange(n), :, np.arange(n)] = self.matrix
        self._rows = each.reshape(-1, size * n)[:, self._free]
        self.kinds = [kind.kind for kind in kinds for _ in kind.matrix]
        lower = np.vstack([kind.lower for kind in kinds]).ravel() + 10.0 * _TOLERANCE
        upper = np.vstack([kind.upper for kind in kinds]).ravel() - 10.0 * _TOLERANCE
        self.moving = n * sum(kind not in ("rest", "stop") for kind in self.kinds)
        # Bounds are widened if the start, or the motion that the spline changes, is at a limit or beyond it.
        at = self._along(np.zeros((size, n)) if spline.changes else braking(problem, spline))
        self.lower = np.minimum(np.maximum(lower, -UNBOUNDED), at)
        self.upper = np.maximum(np.minimum(upper, UNBOUNDED), at)

    def within(self, p: FloatArray) -> FloatArray:
        """Scale control points down until they satisfy the rows of all kinds except "rest" and "stop"."""
        at = self._along(p)[: self.moving]
        return p * self.share(at, self.lower[: self.moving], self.upper[: self.moving])

    def solve(self, hessian: FloatArray, gradient: FloatArray, p: FloatArray) -> FloatArray:
        """Minimise 1/2 x^T hessian x + gradient^T x over feasible steps x from p; return x (M, n).

        Locked joints do not move. If DAQP fails, the unconstrained minimum is scaled down to the limits. If
        `hessian` is not positive definite, the negative gradient is scaled down to the limits.
        """
        free = self._free
        step = np.zeros(p.size)
        if not free.size:
            return step.reshape(p.shape)
        if free.size < p.size:
            hessian, gradient = hessian[np.ix_(free, free)], gradient[free]
        factor = kernel.cholesky(hessian)  # None if rounding makes the matrix indefinite
        step[free] = unbounded = -gradient if factor is None else _solved(factor, -gradient)
        at = self._along(p)
        low, high = self.lower - at, self.upper - at
        move = self._along(step.reshape(p.shape))
        if factor is None or not ((move <= high).all() and (move >= low).all()):
            bounded = None if factor is None else self._bounded(factor, unbounded, move, low, high)
            step = step * self.share(move, low, high) if bounded is None else bounded
        return step.reshape(p.shape)

    def _along(self, p: FloatArray) -> FloatArray:
        """Multiply all rows by control points (M, n)."""
        return np.asarray(self.matrix @ p).ravel()

    def _bounded(
        self, factor: FloatArray, unbounded: FloatArray, move: FloatArray, low: FloatArray, high: FloatArray
    ) -> FloatArray | None:
        """Return the best step x with low <= rows x <= high; None if DAQP fails.

        `factor` is U with hessian = U^T U. DAQP minimises |z|^2 for z = U (x - unbounded) / scale. Its first
        rows are the rows active at x = 0 and the rows that the unconstrained minimum violates. Rows that the
        solution violates are added until the solution satisfies all rows.
        """
        touched = 100.0 * _TOLERANCE
        new = np.flatnonzero((move > high) | (move < low) | (high < touched) | (low > -touched))
        # Rows are scaled to order one, because the solver's tolerances are absolute.
        scale = float(np.linalg.norm(np.triu(factor))) / math.sqrt(len(factor))
        step, rows, transformed = np.zeros(self._size), new[:0], np.empty((0, len(factor)))
        # A warm start for the solver: 1 for active upper bounds, 3 for active lower bounds.
        held = np.where(high < touched, 1, np.where(low > -touched, 3, 0)).astype(np.int32)
        while True:
            columns = kernel.solve_lower(factor, self._rows[new].T)
            rows, transformed = np.append(rows, new), np.concatenate([transformed, scale * columns.T])
            bounds = high[rows] - move[rows], low[rows] - move[rows]
            z, _, status, info = daqp.solve(
                np.eye(len(factor)),
                np.zeros(len(factor)),
                transformed,
                *bounds,
                held[rows],
                primal_tol=_TOLERANCE,
                iter_limit=5 * len(factor),  # 3 len(factor) suffice if there is a solution
            )
            if status != 1 or not np.isfinite(z).all():
                return None
            step[self._free] = unbounded + kernel.solve_upper(factor, scale * z)
            held[rows] = np.where(info["lam"] > 0.0, 1, np.where(info["lam"] < 0.0, 3, 0))
            at = self._along(step.reshape(self.matrix.shape[1], -1))
            outside = (at > high + _TOLERANCE) | (at < low - _TOLERANCE)
            outside[rows] = False
            new = np.flatnonzero(outside)
            if not new.size:
                return step

    def active(self, p: FloatArray) -> list[tuple[str, int]]:
        """Return (kind, joint) of the limits active at control points p (M, n), the most frequent first."""
        at, lower, upper = self._along(p), self.lower, self.upper
        touched = (at > upper - 1e-4 * np.abs(upper)) | (at < lower + 1e-4 * np.abs(lower))
        places = np.argwhere(touched[: self.moving].reshape(-1, p.shape[1]))
        labels = [(self.kinds[k], int(joint)) for k, joint in places]
        return sorted(dict.fromkeys(labels), key=lambda label: -labels.count(label))

    @staticmethod
    def share(move: FloatArray, low: FloatArray, high: FloatArray) -> float:
        """Return the largest share of a move, at most 1, that stays between `low` and `high`."""
        outside = (move > np.maximum(high, 0.0)) | (move < np.minimum(low, 0.0))
        bound = np.where(move > 0.0, high, low)
        return max(0.0, float((bound[outside] / move[outside]).min(initial=1.0)))


def _slowing(bounds: RobotLimits) -> float:
    """Return the longest ratio of braking distance to joint rate [s], half of the braking time at full rate.

    The peak of the deceleration is taken as 1.5 times its mean.
    """
    longest = 1.5 * bounds.velocity / bounds.acceleration
    return 0.5 * float(longest[np.isfinite(longest)].max(initial=_LEAST_STOP))


def _solved(factor: FloatArray, right: FloatArray) -> FloatArray:
    """Return the solution x (M,) of U^T U x = right, with the Cholesky factor U."""
    return kernel.solve_upper(factor, kernel.solve_lower(factor, right[:, None])[:, 0])


def _rows(problem: Problem, spline: RateSpline) -> list[_Rows]:
    """Return the rows of the joint limits, and of joints that rest at the end or can stop after it."""
    rates0, rows = problem.joint_rates, list[_Rows]()

    def add(kind: str, scale: float, points: Map, lower: FloatArray, upper: FloatArray) -> None:
        """Append rows, multiplied by `scale` to give rows of all kinds a similar size."""
        offset = points.given(rates0)  # the contribution of the initial state
        least, most = offset if offset.ndim == 3 else (offset, offset)
        rows.append(_Rows(kind, scale * points.free, scale * (lower - least), scale * (upper - most)))

    for bounds in (limit.joint_bounds for limit in problem.limits):
        if bounds is None:
            continue
        # The finished motion has linear rates between nodes, so its positions differ from the spline's
        # positions by less than `guard`. The error of the trapezoidal rule is dt^2 / 12 times the variation
        # of the acceleration, and this variation is a few times the acceleration limit.
        guard = np.minimum(2.0 * problem.dt**2 * bounds.acceleration, 0.1 * (bounds.upper - bounds.lower))
        guard = np.where(np.isfinite(guard), guard, 0.0)
        low, high = bounds.lower - problem.joints0, bounds.upper - problem.joints0
        add("rate", 1.0, spline.rate_points, -bounds.velocity, bounds.velocity)
        add("acceleration", 0.8, spline.acceleration_points, -bounds.acceleration, bounds.acceleration)
        add("position", 0.3, spline.position_points, low + guard, high - guard)
    if not spline.free_end:
        at_end = Map(spline.rates.free[-1:], spline.rates.fixed[-1:])
        add("rest", 1.0, at_end, -at_rest(problem), at_rest(problem))
    elif problem.goal.coast is not None and (spline.changes or within_workspace(problem)):
        # Joints must be able to brake after a contact. If the goal is outside the workspace, there is none.
        for bounds in filter(None, (limit.joint_bounds for limit in problem.limits)):
            on = problem.goal.coast + _slowing(bounds)
            ends = [
                travel[-1:] + on * rate[-1:] for travel, rate in zip(spline.travel, spline.rates, strict=True)
            ]
            add("stop", 0.3, Map(*ends), bounds.lower - problem.joints0, bounds.upper - problem.joints0)
    return rows
