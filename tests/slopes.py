"""Compute derivatives of residuals by control points, by the chain rule and by finite differences."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt import Problem
from ffsms_pin.opt.derivatives import Variable
from ffsms_pin.opt.rollouts import EXACT, Rollouts, Smoothing
from ffsms_pin.opt.search.gauss_newton import Weighted, arrival, gradients_and_hessians, motions_of
from ffsms_pin.opt.search.spline import RateSpline
from ffsms_pin.system.batch.arm import ArmStack, ArmValues

__all__ = ["by_differences", "by_slopes", "check_arrival", "motions", "tip_turning_slopes", "values_of"]


def motions(problem: Problem, spline: RateSpline, p: FloatArray, smoothing: Smoothing = EXACT) -> Rollouts:
    """Return the rollouts of control points p (S, M, n)."""
    return motions_of(problem, spline, p, smoothing)


def values_of(residuals: list[Variable], shape: tuple[int, int, int]) -> FloatArray:
    """Return all residuals of one motion in a vector; omitted entries are zero."""
    rows: list[FloatArray] = []
    for residual in residuals:
        motion, instants = residual.where or (None, slice(None))
        if motion is None:
            rows.append(residual.value[..., 0, :].ravel())
        else:
            # Squares are summed if several entries (pairs of points) belong to one instant.
            at, square = np.arange(shape[2])[instants], residual.value**2
            total = square.reshape(-1, square.shape[-1]).sum(axis=0)
            rows.append(np.bincount(at, total, minlength=shape[2]).astype(np.float64))
    return np.concatenate(rows) if rows else np.zeros(0)


def by_slopes(problem: Problem, spline: RateSpline, p: FloatArray, residuals: list[Variable]) -> FloatArray:
    """Return the derivatives (rows, n M) of `values_of`, joints first, by the chain rule."""
    at = motions(problem, spline, p)
    rows = []
    for residual in residuals:
        motion, instants = residual.where or (None, slice(None))
        made = _rows(spline, at, residual)
        if motion is None:
            rows.append(made.reshape(-1, made.shape[-1]))
        else:
            squared = np.zeros((len(spline.times), made.shape[-1]))
            values = residual.value.reshape(made.shape[:2])
            by_entry = 2.0 * np.sum(values[..., None] * made, axis=0)
            np.add.at(squared, np.arange(len(spline.times))[instants], by_entry)
            rows.append(squared)
    return np.vstack(rows) if rows else np.zeros((0, problem.sms.n * spline.size))


def _rows(spline: RateSpline, at: Rollouts, residual: Variable) -> FloatArray:
    """Return the derivatives (c, K, n M) of one residual of a motion, joints first."""
    rows = []
    for i in range(len(residual) if residual.ndim == 3 else 1):
        unit = np.zeros_like(residual.value)
        if residual.ndim == 3:
            unit[i] = 1.0
        else:
            unit[:] = 1.0
        entry = Variable(unit, residual.slopes, residual.where)
        for weight in np.eye(residual.shape[-1]):
            gradient, _ = gradients_and_hessians(spline, at, np.array([0]), [Weighted(entry, weight)])
            rows.append(gradient.reshape(spline.size, -1).T.ravel())
    return np.array(rows).reshape(-1, residual.shape[-1], spline.size * at.stack.n)


def by_differences(
    problem: Problem,
    spline: RateSpline,
    p: FloatArray,
    residuals: Callable[[Rollouts], list[Variable]],
    step: float = 1e-6,
) -> FloatArray:
    """Return the derivatives of `values_of` by central differences."""
    n, size = problem.sms.n, spline.size
    shape = (n, 1, len(spline.times))
    out = []
    for j in range(n):
        for i in range(size):
            sides = []
            for sign in (1.0, -1.0):
                moved = p.copy()
                moved[0, i, j] += sign * step
                sides.append(values_of(residuals(motions(problem, spline, moved)), shape))
            out.append((sides[0] - sides[1]) / (2.0 * step))
    return np.array(out).T


def tip_turning_slopes(stack: ArmStack, arm: ArmValues, rates: FloatArray) -> FloatArray:
    """Return the derivatives (3, n, ...) of the tip's angular velocity on a fixed base by joint positions.

    A joint rotates the axes of all joints that it carries.
    """
    carried = np.einsum("kj,j,j...,xj...->xk...", stack.carries, stack.moves_tip, rates, arm.axes)
    return np.cross(arm.axes, carried, axis=0)


def check_arrival(problem: Problem, spline: RateSpline, p: FloatArray, exact: bool) -> None:
    """Check the derivatives of the goal's residuals, at the deadline and in the last tenth of the time.

    With `firm` residuals the gradient of the sum of squares is the same.
    """
    at = motions(problem, spline, p)
    for kind in ("end", "tail"):

        def residuals(rollouts: Rollouts, kind: str = kind, firm: bool = False) -> list[Variable]:
            return list(getattr(arrival(problem.goal, rollouts, firm), kind))

        slopes = by_slopes(problem, spline, p, residuals(at))
        differences = by_differences(problem, spline, p, residuals)
        size = float(np.abs(differences).max())
        assert size > 0.1
        np.testing.assert_allclose(slopes, differences, atol=2e-7 if exact else 1e-3 * size)
        values, held = values_of(residuals(at), (0, 0, 0)), residuals(at, firm=True)
        np.testing.assert_array_equal(values_of(held, (0, 0, 0)), values)
        firmly = by_slopes(problem, spline, p, held)
        np.testing.assert_allclose(values @ firmly, values @ slopes, atol=1e-12 * size * size)
