"""Levenberg and Marquardt's least squares within bounds, for problems that give their own slopes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ffsms_pin import lapack
from ffsms_pin.checks import FloatArray

__all__ = ["least_squares"]

_FIRST, _LEAST, _MOST = 1e-3, 1e-9, 1e6  # damping
_GROWTH = 4.0
_ENOUGH = 1e-4  # relative decrease of the sum of squares that ends it


def least_squares(
    residuals: Callable[[FloatArray], tuple[FloatArray, FloatArray]],
    x: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    iterations: int,
    enough: float = 0.0,
) -> FloatArray:
    """A minimum of |r(x)|^2 near x, within bounds.

    Parameters
    ----------
    residuals : callable
        Gives r (m,) and its slopes (m, k); m may differ from place to place, where entries are zero.
    x, lower, upper : ndarray, shape (k,)
    iterations : int
        How often `residuals` is called at most.
    enough : float
        A decrease of the sum of squares, foreseen or made, that is not worth another call.

    Returns
    -------
    ndarray, shape (k,)
        The best x found.
    """
    x = np.clip(x, lower, upper)
    damping, growth = _FIRST, _GROWTH
    r, S = residuals(x)
    cost = float(r @ r)
    for _ in range(iterations - 1):
        A, gradient = S.T @ S, S.T @ r
        step = _bounded_step(A, gradient, damping, lower - x, upper - x)
        if step is None or -float(step @ (2.0 * gradient + A @ step)) <= enough:
            break
        trial = np.clip(x + step, lower, upper)
        r_trial, S_trial = residuals(trial)
        cost_trial = float(r_trial @ r_trial)
        if cost_trial < cost:
            done = cost - cost_trial <= max(_ENOUGH * cost, enough)
            x, r, S, cost = trial, r_trial, S_trial, cost_trial
            damping, growth = max(damping / 5.0, _LEAST), _GROWTH
            if done:
                break
        else:
            # Each failure in a row by more: a step that is far too long is soon short enough.
            damping, growth = damping * growth, 2.0 * growth
            if damping > _MOST:
                break
    return x


def _bounded_step(
    A: FloatArray, gradient: FloatArray, damping: float, lower: FloatArray, upper: FloatArray
) -> FloatArray | None:
    """The step that minimises the damped quadratic model, those unknowns held that would leave their bounds.

    None where there is none.
    """
    # Unknowns at a bound that the descent would cross stay there.
    moving = np.flatnonzero(~(((lower >= 0.0) & (gradient > 0.0)) | ((upper <= 0.0) & (gradient < 0.0))))
    A = A + np.diag(damping * (1.0 + A.diagonal()))
    step = np.zeros_like(gradient)
    while moving.size:
        # Those that have come to a bound pull at the others through A.
        held = step.copy()
        held[moving] = 0.0
        _, move, info = lapack.dposv(A[np.ix_(moving, moving)], -(gradient + A @ held)[moving])
        if info != 0:
            return None
        step[moving] = np.clip(move, lower[moving], upper[moving])
        inside = step[moving] == move
        if inside.all():
            return step
        moving = moving[inside]
    return step if step.any() else None
