"""Straight moves that something stands in the way of: pushed aside, or tried last.

A descent pushes a colliding motion out of an obstacle on the side that it is on. A move that is bowed in
another direction of the joint space lies on another side.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.horizon.approaches import moves_to
from ffsms_pin.opt.horizon.descent import Model
from ffsms_pin.opt.horizon.merit import linearise
from ffsms_pin.opt.horizon.motions import motions_of, targets
from ffsms_pin.opt.horizon.stages import STRAIGHT_STAGE
from ffsms_pin.opt.horizon.starts import halton, straight_time
from ffsms_pin.opt.motion.motions import EXACT
from ffsms_pin.opt.parts.reading import residuals_of
from ffsms_pin.opt.problem import ARRIVAL_SHARE, Problem
from ffsms_pin.opt.trajectory import Trajectory

__all__ = ["among_obstacles", "best_first", "keep_limits", "obstructed", "pushed_aside"]

_ASIDE = 0.8  # [rad or m] how far the joints are pushed, all together
_STILL = 1e-6  # [rad or m] a joint that goes less far does not move
_COUNT = 4  # moves that are pushed aside a group of starts, and directions tried for each


def among_obstacles(problem: Problem) -> bool:
    """Whether there are obstacles."""
    return any(limit.obstacles for limit in problem.limits)


def obstructed(problem: Problem, plan: Trajectory) -> bool:
    """Whether there are obstacles, and a clearance binds."""
    return any(limit.obstacles and limit.name in plan.binding for limit in problem.limits)


def pushed_aside(model: Model, moves: FloatArray, drawn: int) -> FloatArray:
    """Of straight moves (K, M, n) that come into obstacles, some with their middle pushed aside (L, M, n).

    For each the direction, of a few, in which the clearances lack least is taken.

    Parameters
    ----------
    model : Model
    moves : ndarray, shape (K, M, n)
        Control points.
    drawn : int
        How many directions were drawn before.
    """
    problem = model.problem
    if not among_obstacles(problem):
        return moves[:0]
    blocked = np.flatnonzero(_lack(model, moves) > 0.0)[:_COUNT]
    if not blocked.size:
        return moves[:0]
    n, bump = problem.sms.n, _bump(model)
    ways = 2.0 * halton(drawn, _COUNT, n) - 1.0
    ways = ways * problem.free
    ways *= _ASIDE / np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-9)
    both = np.concatenate([ways, -ways])
    tried = moves[blocked][:, None] + bump[:, None] * both[:, None]
    tried = np.stack([model.qp.within(one) for one in tried.reshape(-1, *moves.shape[1:])])
    lack = _lack(model, tried).reshape(len(blocked), len(both))
    best = np.arange(len(blocked)) * len(both) + lack.argmin(axis=1)
    return np.asarray(tried[best])


def best_first(model: Model, goals: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Joint goals (K, n) in the order in which straight moves to them are worth trying.

    Those first that keep the limits and that there is time for; then the quickest.

    Returns
    -------
    goals : ndarray, shape (K, n)
    good : ndarray, shape (K,)
        Which come first.
    """
    times = np.array([straight_time(model.problem, goal) for goal in goals])
    good = keep_limits(model, goals) & (times <= ARRIVAL_SHARE * model.problem.duration)
    order = np.lexsort((times, ~good))
    return goals[order], good[order]


def keep_limits(model: Model, goals: FloatArray) -> NDArray[np.bool_]:
    """Which straight moves to joint goals (K, n) keep the limits, were the joints quick enough."""
    if not len(goals):
        return np.zeros(0, dtype=bool)
    problem, spline = model.problem, model.spline
    p = moves_to(problem, spline, goals)
    # A joint that there is too little time for stops short of its goal.
    way = goals - problem.joints0
    done = spline.position_points.of(p, problem.joint_rates)[:, -1]
    p *= np.divide(way, done, out=np.ones_like(way), where=np.abs(done) > _STILL)[:, None]
    at = linearise(problem, model.goal, spline, p, STRAIGHT_STAGE.weights, -np.inf)
    return np.asarray(at.limit_share <= 1.0)


def _lack(model: Model, p: FloatArray) -> FloatArray:
    """Squares of what motions lack of the limits that know obstacles, over time (S,)."""
    problem, spline = model.problem, model.spline
    motions = motions_of(problem, spline, p, EXACT, targets(model.goal, spline.times))
    lack = np.zeros(len(p))
    for limit in (one for one in problem.limits if one.obstacles):
        for residual in residuals_of(limit, motions):
            lack += residual.squares(motions.limit_weights, len(p))
    return lack


def _bump(model: Model) -> FloatArray:
    """Control points (M,) of the joint that goes by one to the side, and back, with least acceleration."""
    spline = model.spline
    travel = spline.travel.free
    middle = int(np.argmin(np.abs(spline.times - 0.5 * spline.times[-1])))
    held = np.stack([travel[middle], spline.position_points.free[-1]])
    system = np.block([[spline.squared_acceleration, held.T], [held, np.zeros((2, 2))]])
    return np.asarray(np.linalg.solve(system, np.append(np.zeros(spline.size), [1.0, 0.0]))[:-2])
