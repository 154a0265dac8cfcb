"""Levenberg-Marquardt within the joint limits, for several motions side by side.

Reference: J. Nocedal, S. J. Wright, "Numerical Optimization", 2nd ed., 2006, ch. 10.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.goals import Goal
from ffsms_pin.opt.horizon.control_qp import ControlQP
from ffsms_pin.opt.horizon.merit import Linearisation, Weights, linearise
from ffsms_pin.opt.horizon.spline import Grid, RateSpline, rate_spline
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.terms.term import REFERENCE_TIME

__all__ = ["Candidates", "Model", "descend"]

_LEAST_DAMPING, _MOST_DAMPING = 1e-6, 1e4
_HOPELESS = 1e3  # a step that fails even under this damping will not be found
_STALL = 1e-3  # the relative gain below which a motion drops out
_MERIT_NOISE = 1e-4  # added to the merit in that: gains below a tenth of this per thousand are nothing


@dataclass(frozen=True, eq=False)
class Model:
    """A problem on one spline, with the solver of its steps.

    Attributes
    ----------
    problem : Problem
    goal : Goal
        The problem's, or that goal shifted.
    spline : RateSpline
    qp : ControlQP
    """

    problem: Problem
    goal: Goal
    spline: RateSpline
    qp: ControlQP

    @classmethod
    def make(cls, problem: Problem, grid: Grid) -> Model:
        """The problem on a spline so fine."""
        moving = not problem.goal.place(problem.duration).rests
        spline = rate_spline(problem.steps, problem.dt, grid, moving)
        return cls(problem, problem.goal, spline, ControlQP(problem, spline))

    @property
    def time(self) -> float:
        """Scale of times: 1 for a motion of 8 s."""
        return self.problem.duration / REFERENCE_TIME


@dataclass
class Candidates:
    """Motions under way: control points (S, M, n), their linearisations and dampings (S,).

    A damping is that of a motion of 8 s, like the weights.
    """

    p: FloatArray
    at: Linearisation
    damping: FloatArray

    @classmethod
    def start(
        cls, model: Model, p: FloatArray, weights: Weights, damping: float | FloatArray = 1e-2
    ) -> Candidates:
        """Motions linearised under these weights."""
        at = linearise(model.problem, model.goal, model.spline, p, weights)
        return cls(p.copy(), at, np.broadcast_to(damping, len(p)).astype(np.float64))

    def take(self, index: Any) -> Candidates:
        """The motions at an index."""
        return Candidates(self.p[index], self.at.take(index), self.damping[index])

    def join(self, other: Candidates) -> Candidates:
        """These motions and then the others."""
        return Candidates(
            np.concatenate([self.p, other.p]),
            self.at.join(other.at),
            np.concatenate([self.damping, other.damping]),
        )


def descend(model: Model, motions: Candidates, weights: Weights, iterations: int) -> Candidates:
    """Iterate, all motions in step; those that stall drop out. Changes `motions` and returns it.

    What follows begins under other weights, or is the end: the last iteration makes no derivatives.
    """
    size = motions.p[0].size
    diagonal = np.arange(size)
    live = np.arange(len(motions.p))
    for left in reversed(range(iterations)):
        hessian, gradient = motions.at.hessian[live], motions.at.gradient[live]
        damped = hessian.copy()
        damped[:, diagonal, diagonal] += model.time**3 * motions.damping[live, None]
        steps = np.stack(
            [model.qp.solve(H, g, p) for H, g, p in zip(damped, gradient, motions.p[live], strict=True)]
        )
        flat = steps.reshape(len(live), size, 1)
        expected = -2.0 * np.einsum("si,si->s", gradient, flat[..., 0])
        expected -= np.einsum("si,si->s", flat[..., 0], (hessian @ flat)[..., 0])
        trial = motions.p[live] + steps
        new = linearise(
            model.problem,
            model.goal,
            model.spline,
            trial,
            weights,
            motions.at.merit[live] if left else -np.inf,
        )
        gain = motions.at.merit[live] - new.merit
        better = gain > 0.0
        if better.all() and len(live) == len(motions.p):
            motions.p, motions.at = trial, new
        else:
            motions.p[live[better]] = trial[better]
            motions.at.put(live[better], new.take(better))
        ratio = gain / np.maximum(expected, 1e-15)
        factor = np.where(~better, 6.0, np.where(ratio > 0.7, 0.2, np.where(ratio > 0.3, 0.5, 2.0)))
        damping = np.clip(motions.damping[live] * factor, _LEAST_DAMPING, _MOST_DAMPING)
        motions.damping[live] = damping
        stalled = np.where(
            better, gain < _STALL * (new.merit + model.time * _MERIT_NOISE), damping > _HOPELESS
        )
        live = live[~stalled]
        if not live.size:
            break
    return motions
