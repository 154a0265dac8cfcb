"""The quadratic programme of one step of the descent: a model of the merit under every joint limit.

Determinism: where the unconstrained minimum keeps the limits, a Cholesky factorisation gives it. Otherwise
ProxQP finds the active rows, and the equations of these rows are solved once more, so that what
comes out depends on the rows alone and not on where ProxQP stopped. Where the rows give no solution, the
unconstrained step is shortened onto the limits: a poor step, which the descent will reject or damp.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from proxsuite import proxqp
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
_TOLERANCE = 1e-8
_CORRECTIONS = 12  # usually none to three are needed
_MAX_ITERATIONS = 100  # what needs more is shortened instead
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
            for i in range(n):
                if np.isinf(least[i]) and np.isinf(most[i]):
                    continue
                unit = np.zeros(n)
                unit[i] = scale
                rows.append(np.kron(matrix, unit))
                lower.append(np.full(len(matrix), max(scale * least[i] + _RESERVE, -_NO_BOUND)))
                upper.append(np.full(len(matrix), min(scale * most[i] - _RESERVE, _NO_BOUND)))
                self.labels.extend([(name, i)] * len(matrix))
        self.rows, self.lower, self.upper = np.vstack(rows), np.concatenate(lower), np.concatenate(upper)
        self.moving = len(self.labels) - n
        # A start at its limit: zero must stay feasible.
        self.lower, self.upper = np.minimum(self.lower, 0.0), np.maximum(self.upper, 0.0)
        self._qp: Any = None

    def solve(self, hessian: FloatArray, gradient: FloatArray, p: FloatArray) -> FloatArray:
        """Minimise 1/2 x^T hessian x + gradient^T x over steps x, shaped like p (M, n)."""
        factor, info = lapack.dpotrf(hessian)
        free = -gradient if info else lapack.dpotrs(factor, -gradient)[0]
        at = self.rows @ p.ravel()
        low, high = self.lower - at, self.upper - at
        move = self.rows @ free
        if info == 0 and (move <= high).all() and (move >= low).all():
            return np.asarray(free).reshape(p.shape)
        # Of order one: ProxQP takes a fifth of the iterations.
        scale = len(gradient) / float(np.trace(hessian))
        step = self._constrained(scale * hessian, scale * gradient, low, high)
        if step is None:
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

    def _constrained(
        self, H: FloatArray, g: FloatArray, low: FloatArray, high: FloatArray
    ) -> FloatArray | None:
        if self._qp is None:
            dense = proxqp.dense
            self._qp = dense.QP(
                len(g), 0, len(low), False, dense.HessianType.Dense, dense.DenseBackend.PrimalDualLDLT
            )
            settings = self._qp.settings
            settings.eps_abs, settings.eps_rel, settings.max_iter = _TOLERANCE, 0.0, _MAX_ITERATIONS
            # Warm starts from the step of another motion make some solves stall.
            settings.initial_guess = proxqp.InitialGuess.NO_INITIAL_GUESS
            self._qp.init(H, g, None, None, self.rows, low, high)
        else:
            self._qp.update(H=H, g=g, l=low, u=high)
        self._qp.solve()
        z = np.array(self._qp.results.z)
        if not np.isfinite(z).all():
            return None
        return self._settle(H, g, low, high, np.sign(np.where(np.abs(z) > _TOLERANCE, z, 0.0)))

    def _settle(
        self, H: FloatArray, g: FloatArray, low: FloatArray, high: FloatArray, side: FloatArray
    ) -> FloatArray | None:
        """The solution from a guess of the active rows, side -1, 0 or 1; None where they do not settle.

        Solve the equations of the active rows; drop rows that pull instead of push, add rows that are broken;
        repeat until none is (a primal-dual active-set iteration).

        Reference: M. Hintermueller, K. Ito, K. Kunisch, "The primal-dual active set strategy as a semismooth
        Newton method", SIAM J. Optim. 13 (2002).
        """
        n = len(g)
        for _ in range(_CORRECTIONS):
            active = np.flatnonzero(side)
            k = len(active)
            kkt = np.zeros((n + k, n + k), order="F")
            kkt[:n, :n] = H
            kkt[n:, :n] = self.rows[active]
            kkt[:n, n:] = kkt[n:, :n].T
            bounds = np.where(side[active] > 0.0, high[active], low[active])
            _, _, solution, info = lapack.dgesv(
                kkt, np.append(-g, bounds), overwrite_a=True, overwrite_b=True
            )
            if info != 0 or not np.isfinite(solution).all():
                return None
            x, push = solution[:n], solution[n:] * side[active]
            move = self.rows @ x
            new = np.where(
                move > high + 0.5 * _RESERVE, 1.0, np.where(move < low - 0.5 * _RESERVE, -1.0, side)
            )
            new[active[push < 0.0]] = 0.0
            if (new == side).all():
                return np.asarray(x)
            side = new
        return None

    @staticmethod
    def share(move: FloatArray, low: FloatArray, high: FloatArray) -> float:
        """The largest share of a step that keeps the limits."""
        room = np.ones_like(move)
        over, under = move > np.maximum(high, 0.0), move < np.minimum(low, 0.0)
        room[over] = high[over] / move[over]
        room[under] = low[under] / move[under]
        return max(0.0, float(room.min(initial=1.0)))
