"""Starts that get around obstacles: straight moves whose middle is pushed aside.

A descent pushes a colliding motion out of an obstacle on the side that it is on. A move that is bowed in
another direction of the joint space lies on another side.
"""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.batch.motions import EXACT
from ffsms_pin.opt.horizon.descent import Model
from ffsms_pin.opt.horizon.motions import motions_of, targets
from ffsms_pin.opt.horizon.starts import halton
from ffsms_pin.opt.limits import Clearance
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.trajectory import Trajectory

__all__ = ["among_obstacles", "obstructed", "pushed_aside"]

_ASIDE = 0.8  # [rad or m] how far the joints are pushed, all together
_COUNT = 4  # moves that are pushed aside a group of starts, and directions tried for each


def among_obstacles(problem: Problem) -> bool:
    """Whether there are obstacles."""
    return any(isinstance(one, Clearance) and one.obstacles for one in problem.limits)


def obstructed(problem: Problem, plan: Trajectory) -> bool:
    """Whether there are obstacles, and a clearance binds."""
    around = (one for one in problem.limits if isinstance(one, Clearance) and one.obstacles)
    return any(limit.name in plan.binding for limit in around)


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


def _lack(model: Model, p: FloatArray) -> FloatArray:
    """Squares of what the clearances of motions lack, over time (S,)."""
    problem, spline = model.problem, model.spline
    motions = motions_of(problem, spline, p, EXACT, targets(model.goal, spline.times))
    lack = np.zeros(len(p))
    for limit in problem.limits:
        if isinstance(limit, Clearance):
            for residual in limit.around_residual(motions):
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
