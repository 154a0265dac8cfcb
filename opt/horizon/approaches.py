"""Starts that come up to the goal as it asks: by way of a place shortly before it.

A straight joint-space move arrives from anywhere. A goal with an approach is entered from one side, and a
descent does not find the way round from the other; so such a goal gets moves that pass its approach.
"""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.horizon.spline import RateSpline
from ffsms_pin.opt.horizon.starts import straight_moves
from ffsms_pin.opt.problem import Problem
from ffsms_pin.system.batch.stacks import apply, log3

__all__ = ["moves_to"]

_SAMPLES = 60  # instants at which the spline is fitted to a move
_DAMPING = 1e-3  # of the least squares, in squares of the arm's length


def moves_to(problem: Problem, spline: RateSpline, goals: FloatArray) -> FloatArray:
    """Control points (K, M, n) of moves to joint goals (K, n): straight, or through the goal's approach."""
    passing = problem.goal.passing(problem.duration)
    if passing is None or not len(goals):
        return straight_moves(problem, spline, goals)
    at, before = passing
    end = problem.goal.place(problem.duration)
    assert end.rotation is not None
    assert before.rotation is not None
    velocity, spin = (np.zeros(3) if one is None else one for one in (end.velocity, end.spin))

    arm = problem.stack.evaluate(goals.T)
    R = np.einsum("xy,zyk->xzk", end.rotation, arm.tip_rotation)  # of the base, where the tip is at the goal
    turning = arm.spin + arm.axes * problem.stack.moves_tip[:, None]
    J = np.concatenate([apply(R, arm.jstar), apply(R, turning)]).transpose(2, 0, 1) * problem.free
    left = problem.duration - at
    back = end.position - before.position - left * problem.drift
    step = np.concatenate([back, log3((end.rotation @ before.rotation.T)[..., None])[:, 0]])
    rates = _least_squares(problem, J, np.concatenate([velocity - problem.drift, spin]))
    low, high = problem.sms.limits.lower, problem.sms.limits.upper
    passed = np.clip(goals - _least_squares(problem, J, step), low, high)

    times = (np.arange(_SAMPLES) + 0.5) * problem.duration / _SAMPLES
    through = (goals - passed) / left
    start = np.broadcast_to(problem.joints0, goals.shape)
    first = _hermite_rates(
        np.minimum(times, at) / at, at, start, problem.joint_rates + 0.0 * goals, passed, through
    )
    last = _hermite_rates(np.maximum(times - at, 0.0) / left, left, passed, through, goals, rates)
    wanted = np.where((times < at)[:, None], first, last)
    maps = spline.rates_at(times)
    return np.asarray(np.linalg.pinv(maps.free) @ (wanted - maps.fixed[:, None] * problem.joint_rates))


def _least_squares(problem: Problem, J: FloatArray, wanted: FloatArray) -> FloatArray:
    """Least joint motion (K, n) with J u near to `wanted` (6,)."""
    square = J @ np.swapaxes(J, 1, 2) + _DAMPING * problem.stack.length**2 * np.eye(6)
    solved = np.linalg.solve(square, np.broadcast_to(wanted[:, None], (len(J), 6, 1)))
    return np.asarray((np.swapaxes(J, 1, 2) @ solved)[..., 0])


def _hermite_rates(
    s: FloatArray, span: float, x0: FloatArray, u0: FloatArray, x1: FloatArray, u1: FloatArray
) -> FloatArray:
    """Rates (K, T, n) at shares s (T,) of a span, of cubics between positions and rates (K, n)."""
    s = s[:, None]
    way = (x1 - x0)[:, None] / span
    return np.asarray(
        6.0 * s * (1.0 - s) * way
        + (1.0 - s) * (1.0 - 3.0 * s) * u0[:, None]
        + s * (3.0 * s - 2.0) * u1[:, None]
    )
