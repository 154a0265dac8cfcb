"""Slopes of residuals by control points: by the library's chain rule, and by finite differences."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt import Problem
from ffsms_pin.opt.horizon.arrival import arrival
from ffsms_pin.opt.horizon.merit import Weighted, motions_of, sums
from ffsms_pin.opt.horizon.spline import RateSpline
from ffsms_pin.opt.motion.motions import EXACT, Motions, Smoothing
from ffsms_pin.opt.motion.residual import JointResidual, Residual, Residuals
from ffsms_pin.system.batch.arm import ArmStack, ArmValues

__all__ = ["by_differences", "by_slopes", "check_arrival", "motions", "tip_turning_slopes", "values_of"]


def motions(problem: Problem, spline: RateSpline, p: FloatArray, smoothing: Smoothing = EXACT) -> Motions:
    """Motions of control points p (S, M, n)."""
    return motions_of(problem, spline, p, smoothing)


def values_of(residuals: Residuals, shape: tuple[int, int, int]) -> FloatArray:
    """All residuals of one motion in one vector; entries that are left out are zero."""
    _n, _, instants = shape
    rows: list[FloatArray] = []
    for residual in residuals:
        if isinstance(residual, JointResidual):
            rows.append(np.broadcast_to(residual.value, shape)[:, 0].ravel())
        elif residual.motion is None:
            rows.append(residual.value[0])
        else:
            # Several entries may stand at one instant (pairs of points): their squares add up.
            at = np.arange(instants)[residual.instants]
            rows.append(np.bincount(at, residual.value**2, minlength=instants).astype(np.float64))
    return np.concatenate(rows) if rows else np.zeros(0)


def by_slopes(problem: Problem, spline: RateSpline, p: FloatArray, residuals: Residuals) -> FloatArray:
    """Slopes (rows, n M) of `values_of`, joints first, by the chain rule."""
    at = motions(problem, spline, p)
    n, instants, size = problem.sms.n, len(spline.times), spline.size
    rows = []
    for residual in residuals:
        if isinstance(residual, JointResidual):
            made = np.zeros((n, instants, n, size))
            parts = (
                (residual.by_position, spline.travel.free),
                (residual.by_rate, spline.rates.free),
                (residual.by_acceleration, spline.accelerations.free),
            )
            for slope, free in parts:
                if slope is not None:
                    for j in range(n):
                        made[j, :, j] += np.broadcast_to(slope, (n, 1, instants))[j, 0][:, None] * free
            rows.append(made.reshape(n * instants, -1))
        elif residual.motion is None:
            rows.append(_rows(spline, at, residual))
        else:
            squared = np.zeros((instants, n * size))
            assert isinstance(residual, Residual)
            where = np.arange(instants)[residual.instants]
            np.add.at(squared, where, 2.0 * residual.value[:, None] * _rows(spline, at, residual))
            rows.append(squared)
    return np.vstack(rows) if rows else np.zeros((0, n * size))


def _rows(spline: RateSpline, at: Motions, residual: Residual) -> FloatArray:
    """Slopes (values, n M) of one motion's residual, joints first: gradients of its values, one by one."""
    ones = replace(residual, value=np.ones_like(residual.value))
    rows = []
    for weight in np.eye(residual.value.shape[-1]):
        gradient, _ = sums(spline, at, np.array([0]), [Weighted(ones, weight)])
        rows.append(gradient.reshape(spline.size, -1).T.ravel())
    return np.array(rows).reshape(len(rows), -1)


def by_differences(
    problem: Problem,
    spline: RateSpline,
    p: FloatArray,
    residuals: Callable[[Motions], Residuals],
    step: float = 1e-6,
) -> FloatArray:
    """The same by central differences."""
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
    """Slopes (3, n, ...) by the joint positions of the end effector's angular velocity on a fixed base.

    A joint turns the axes of all joints that it carries.
    """
    carried = np.einsum("kj,j,j...,xj...->xk...", stack.carries, stack.moves_tip, rates, arm.axes)
    return np.cross(arm.axes, carried, axis=0)


def check_arrival(problem: Problem, spline: RateSpline, p: FloatArray, exact: bool) -> None:
    """Slopes of what the goal asks for, at the deadline and in the last tenth, are those of differences."""
    at = motions(problem, spline, p)
    for kind in ("end", "tail"):

        def residuals(one: Motions, kind: str = kind) -> Residuals:
            return list(getattr(arrival(problem.goal, one), kind))

        slopes = by_slopes(problem, spline, p, residuals(at))
        differences = by_differences(problem, spline, p, residuals)
        size = float(np.abs(differences).max())
        assert size > 0.1
        np.testing.assert_allclose(slopes, differences, atol=2e-7 if exact else 1e-3 * size)
