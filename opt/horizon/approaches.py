"""Starts that come up to the goal as it asks: by way of places shortly before it.

A straight joint-space move arrives from anywhere. A goal with an approach is entered from one side, and a
descent does not find the way round from the other; so such a goal gets moves that pass its approach.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.goals import Place
from ffsms_pin.opt.horizon.shooting import GoalFromStart
from ffsms_pin.opt.horizon.spline import RateSpline
from ffsms_pin.opt.horizon.starts import straight_moves
from ffsms_pin.opt.motion.frame import RobotFrame
from ffsms_pin.opt.motion.motions import apply_rates
from ffsms_pin.opt.problem import Problem
from ffsms_pin.system.batch.stacks import exp3

__all__ = ["missed_at", "moves_to"]

_SAMPLES = 60  # instants at which the spline is fitted to a move
_DAMPING = 1e-3  # of the least squares, in squares of the arm's length
_NEWTON = 6  # steps back from one place to the one before it
_STEP = 0.2  # [rad or m] largest of a joint in such a step
# [arm lengths] What a radian counts on the way: an arm that is stretched out at the goal may not be able to
# keep its attitude and go back from there.
_TURN = 0.1


class _Postures(NamedTuple):
    """Joint positions (K, n), and attitudes of the base (3, 3, K)."""

    joints: FloatArray
    base: FloatArray


def moves_to(problem: Problem, spline: RateSpline, goals: FloatArray) -> FloatArray:
    """Control points (K, M, n) of moves to joint goals (K, n): straight, or by way of the goal's approach."""
    approach = problem.goal.approach(problem.duration)
    if not approach or not len(goals):
        return straight_moves(problem, spline, goals)
    end, arm = problem.goal.place(problem.duration), problem.stack.evaluate(goals.T)
    velocity, spin = (np.zeros(3) if one is None else one for one in (end.velocity, end.spin))
    # The base as it is turned where the tip is at the goal.
    at = _Postures(goals, end.base_attitude(arm.tip_rotation))
    J = missed_at(problem, end, problem.duration, *at)[1]
    rates = [_least_squares(J, np.concatenate([velocity - problem.drift, spin]), problem)]
    times, places = [problem.duration], [goals]
    for t, place in reversed(approach):
        at = _back(problem, at, t, place)
        times.insert(0, t)
        places.insert(0, at.joints)
    for i in range(len(approach) - 1, -1, -1):
        before = max(i - 1, 0)
        rates.insert(0, (places[i + 1] - places[before]) / (times[i + 1] - times[before]))
    times.insert(0, 0.0)
    places.insert(0, np.broadcast_to(problem.joints0, goals.shape))
    rates.insert(0, np.broadcast_to(problem.joint_rates, goals.shape))

    instants = (np.arange(_SAMPLES) + 0.5) * problem.duration / _SAMPLES
    wanted = _hermite_rates(instants, np.array(times), np.array(places), np.array(rates))
    maps = spline.rates_at(instants)
    return np.asarray(np.linalg.pinv(maps.free) @ (wanted - maps.fixed[:, None] * problem.joint_rates))


def missed_at(
    problem: Problem, place: Place, t: float, joints: FloatArray, base: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """What postures (K, n) on bases in attitudes (3, 3, K) miss of a place at t [s], (K, 6).

    And how fast the joints make it up, the base reacting, (K, 6, n).
    """
    centre = problem.com0 + t * problem.drift
    wanted = GoalFromStart(place.transformed(-centre, np.eye(3)), RobotFrame.tip(problem.stack))
    error, columns = wanted.missed(problem.stack.evaluate(joints.T), base)
    return error.T, columns.transpose(2, 0, 1) * problem.free


def _back(problem: Problem, at: _Postures, t: float, place: Place) -> _Postures:
    """From postures to those with the end effector at a place: Newton's method, the base reacting."""
    joints, base = at
    low, high = problem.sms.limits.lower, problem.sms.limits.upper
    stuck = np.zeros(joints.shape, dtype=bool)
    for _ in range(_NEWTON):
        missed, J = missed_at(problem, place, t, joints, base)
        weights = np.repeat([1.0, _TURN * problem.stack.length], [3, missed.shape[1] - 3])
        step = _least_squares(weights[:, None] * J * ~stuck[:, None], weights * missed, problem)
        step *= np.minimum(1.0, _STEP / np.maximum(np.abs(step).max(axis=1), 1e-9))[:, None]
        wanted = joints + step
        stuck = (wanted < low) | (wanted > high)
        step = np.clip(wanted, low, high) - joints
        spin = problem.stack.evaluate(joints.T).spin
        base = np.einsum("xyk,yzk->xzk", base, exp3(apply_rates(spin, step.T)))
        joints = joints + step
    return _Postures(joints, base)


def _least_squares(J: FloatArray, wanted: FloatArray, problem: Problem) -> FloatArray:
    """Least joint motion (K, n) with J u near to `wanted`, (m,) or (K, m)."""
    rows = J.shape[1]
    square = J @ np.swapaxes(J, 1, 2) + _DAMPING * problem.stack.length**2 * np.eye(rows)
    solved = np.linalg.solve(square, np.broadcast_to(wanted[..., None], (len(J), rows, 1)))
    return np.asarray((np.swapaxes(J, 1, 2) @ solved)[..., 0])


def _hermite_rates(t: FloatArray, nodes: FloatArray, x: FloatArray, u: FloatArray) -> FloatArray:
    """Rates (K, T, n) at times t (T,) of cubics between nodes (N,) with positions and rates (N, K, n)."""
    i = np.clip(np.searchsorted(nodes, t, side="right") - 1, 0, len(nodes) - 2)
    span = np.diff(nodes)[i][:, None, None]
    s = ((t - nodes[i]) / np.diff(nodes)[i])[:, None, None]
    rates = 6.0 * s * (1.0 - s) * (x[i + 1] - x[i]) / span
    rates = rates + (1.0 - s) * (1.0 - 3.0 * s) * u[i] + s * (3.0 * s - 2.0) * u[i + 1]
    return np.asarray(np.swapaxes(rates, 0, 1))
