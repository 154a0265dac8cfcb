"""Levenberg-Marquardt within the joint limits, for several motions side by side.

Reference: J. Nocedal, S. J. Wright, "Numerical Optimization", 2nd ed., 2006, ch. 10.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.horizon.limits_qp import LimitsQP
from ffsms_pin.opt.horizon.linearisation import Linearisation, linearise
from ffsms_pin.opt.horizon.spline import RateSpline
from ffsms_pin.opt.horizon.task import Task
from ffsms_pin.opt.horizon.weights import Weights

__all__ = ["Motions", "Workbench", "descend"]

_LEAST_DAMPING, _MOST_DAMPING = 1e-6, 1e4
_HOPELESS = 1e3  # a step that fails even under this damping will not be found
_STALL = 1e-3  # the relative gain below which a motion drops out
_MERIT_NOISE = 1e-4  # added to the merit in that: gains below a tenth of this per thousand are nothing


@dataclass(frozen=True, eq=False)
class Workbench:
    """A task on one spline, with the solver of its steps."""

    task: Task
    spline: RateSpline
    qp: LimitsQP

    @classmethod
    def make(cls, task: Task, spline: RateSpline) -> Workbench:
        """A workbench of its own solver."""
        return cls(task, spline, LimitsQP(task, spline))


@dataclass
class Motions:
    """Motions under way: control points (S, M, n), their linearisations and dampings (S,).

    A damping is that of a motion of 8 s, like the weights.
    """

    p: FloatArray
    at: Linearisation
    damping: FloatArray

    @classmethod
    def start(
        cls, bench: Workbench, p: FloatArray, weights: Weights, damping: float | FloatArray = 1e-2
    ) -> Motions:
        """Motions linearised under these weights."""
        at = linearise(bench.task, bench.spline, p, weights)
        return cls(p.copy(), at, np.broadcast_to(damping, len(p)).astype(np.float64))

    def take(self, index: Any) -> Motions:
        """The motions at an index."""
        return Motions(self.p[index], self.at.take(index), self.damping[index])

    def join(self, other: Motions) -> Motions:
        """These motions and then the others."""
        return Motions(
            np.concatenate([self.p, other.p]),
            self.at.join(other.at),
            np.concatenate([self.damping, other.damping]),
        )


def descend(bench: Workbench, motions: Motions, weights: Weights, iterations: int) -> Motions:
    """Iterate, all motions in step; those that stall drop out. Changes `motions` and returns it.

    What follows begins under other weights, or is the end: the last iteration makes no derivatives.
    """
    size = motions.p[0].size
    diagonal = np.arange(size)
    live = np.arange(len(motions.p))
    for left in reversed(range(iterations)):
        hessian, gradient = motions.at.hessian[live], motions.at.gradient[live]
        damped = hessian.copy()
        damped[:, diagonal, diagonal] += bench.task.time**3 * motions.damping[live, None]
        steps = np.stack(
            [bench.qp.solve(H, g, p) for H, g, p in zip(damped, gradient, motions.p[live], strict=True)]
        )
        flat = steps.reshape(len(live), size, 1)
        expected = -2.0 * np.einsum("si,si->s", gradient, flat[..., 0])
        expected -= np.einsum("si,si->s", flat[..., 0], (hessian @ flat)[..., 0])
        trial = motions.p[live] + steps
        new = linearise(bench.task, bench.spline, trial, weights, motions.at.merit[live] if left else -np.inf)
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
            better, gain < _STALL * (new.merit + bench.task.time * _MERIT_NOISE), damping > _HOPELESS
        )
        live = live[~stalled]
        if not live.size:
            break
    return motions
