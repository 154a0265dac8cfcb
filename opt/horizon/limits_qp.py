"""The quadratic programme of one step of the descent: a model of the merit under every joint limit.

Determinism: where the unconstrained minimum keeps the limits, a Cholesky factorisation gives it. Otherwise
DAQP, a dual active-set method, ends at the solution that belongs to its active rows, exactly and always the
same; an interior-point or proximal method stops somewhere near. It is also several times faster on a few
dozen unknowns. Where it finds none, the unconstrained step is shortened onto the limits: a poor step, which
the descent will reject or damp.

Reference: D. Arnstroem, A. Bemporad, D. Axehill, "A dual active-set solver for embedded quadratic programming
using recursive LDL^T updates", IEEE Transactions on Automatic Control 67 (2022).
"""

from __future__ import annotations

import daqp
import numpy as np
from scipy.linalg import lapack

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.horizon.spline import RateSpline
from ffsms_pin.opt.horizon.task import Task

__all__ = ["AT_REST", "LimitsQP"]

# [rad/s] At the last node: small enough to count as rest, large enough to have a direction.
AT_REST = 8e-4
_REST_SHARE = 2e-3  # of the rate limit, for slow arms
# Kept in hand on every row, for the tolerance below.
_RESERVE = 1e-6
_TOLERANCE = 1e-7
_MAX_ITERATIONS = 1000  # a few dozen are usual
_NO_BOUND = 1e20


class LimitsQP:
    """Steps x that keep the control points p + x of a spline within the limits.

    Parameters
    ----------
    task : Task
    spline : RateSpline

    Attributes
    ----------
    rows : ndarray, shape (k, Mn)
    lower, upper : ndarray, shape (k,)
        lower <= rows p <= upper; p flattened with the joints last.
    moving : int
        The first rows, all but those that ask for rest at the end.
    labels : list of (str, int)
        What each row limits: "rate", "acceleration" or "position", and the joint's index.
    """

    def __init__(self, task: Task, spline: RateSpline) -> None:
        limits, n, size, joints0 = task.sms.limits, task.arm.n, spline.size, task.joints0
        # The nodes join the spline's rates by straight lines; the positions differ by less than this. The
        # trapezoidal rule errs by dt^2 / 12 times the variation of the acceleration, a few times its limit.
        guard = np.minimum(2.0 * task.dt**2 * limits.acceleration, 0.1 * (limits.upper - limits.lower))
        guard = np.where(np.isfinite(guard), guard, 0.0)
        low = np.minimum(limits.lower + guard - joints0, 0.0)
        high = np.maximum(limits.upper - guard - joints0, 0.0)
        rest = np.minimum(AT_REST, _REST_SHARE * limits.velocity)
        # Rows of like size: rates over 1 s, accelerations over 0.8 s^2, positions over 3 s.
        kinds = [
            ("rate", 1.0, np.eye(size), -limits.velocity, limits.velocity),
            ("acceleration", 0.8, spline.acceleration, -limits.acceleration, limits.acceleration),
            ("position", 0.3, spline.position, low, high),
            ("rest", 1.0, spline.last_rate[None], -rest, rest),
        ]
        rows, lower, upper = [], [], []
        self.labels: list[tuple[str, int]] = []
        for name, scale, matrix, least, most in kinds:
            # Those of one control point after the other, the joints last: the rates' are the identity.
            block = np.zeros((len(matrix), n, size, n))
            for i in range(n):
                block[:, i, :, i] = scale * matrix
            rows.append(block.reshape(-1, size * n))
            lower.append(np.tile(np.maximum(scale * least + _RESERVE, -_NO_BOUND), len(matrix)))
            upper.append(np.tile(np.minimum(scale * most - _RESERVE, _NO_BOUND), len(matrix)))
            self.labels.extend((name, i) for _ in matrix for i in range(n))
        self.rows, self.lower, self.upper = np.vstack(rows), np.concatenate(lower), np.concatenate(upper)
        self._others = self.rows[size * n :]
        self.moving = len(self.labels) - n
        # A start at its limit: zero must stay feasible.
        self.lower, self.upper = np.minimum(self.lower, 0.0), np.maximum(self.upper, 0.0)

    def solve(self, hessian: FloatArray, gradient: FloatArray, p: FloatArray) -> FloatArray:
        """Minimise 1/2 x^T hessian x + gradient^T x over steps x, shaped like p (M, n)."""
        factor, info = lapack.dpotrf(hessian)
        free = -gradient if info else lapack.dpotrs(factor, -gradient)[0]
        at = self.rows @ p.ravel()
        low, high = self.lower - at, self.upper - at
        move = self.rows @ free
        if info == 0 and (move <= high).all() and (move >= low).all():
            return np.asarray(free).reshape(p.shape)
        # Of order one: the solver's tolerances are absolute.
        scale = len(gradient) / float(np.trace(hessian))
        options = {"primal_tol": _TOLERANCE, "iter_limit": _MAX_ITERATIONS}
        # Bounds without a row are those of x itself.
        step, _, status, _ = daqp.solve(scale * hessian, scale * gradient, self._others, high, low, **options)
        if status != 1 or not np.isfinite(step).all():
            step = free * self.share(move, low, high)
        return np.asarray(step).reshape(p.shape)

    def active(self, p: FloatArray) -> list[tuple[str, int]]:
        """Kind and joint of the limits that control points p touch, most often touched first."""
        at = self.rows @ p.ravel()
        touched = (at > self.upper - 1e-4 * np.abs(self.upper)) | (
            at < self.lower + 1e-4 * np.abs(self.lower)
        )
        found = [
            label for label, here in zip(self.labels, touched, strict=True) if here and label[0] != "rest"
        ]
        return sorted(set(found), key=lambda label: -found.count(label))

    @staticmethod
    def share(move: FloatArray, low: FloatArray, high: FloatArray) -> float:
        """The largest share of a step that keeps the limits."""
        room = np.ones_like(move)
        over, under = move > np.maximum(high, 0.0), move < np.minimum(low, 0.0)
        room[over] = high[over] / move[over]
        room[under] = low[under] / move[under]
        return max(0.0, float(room.min(initial=1.0)))
