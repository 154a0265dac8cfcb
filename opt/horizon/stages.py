"""Successive halving: many motions for a few iterations, the best of them for more, on a finer spline.

Reference: K. Jamieson, A. Talwalkar, "Non-stochastic best arm identification and hyperparameter
optimization", 2016 (the idea; its bandit setting does not matter here).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.horizon.descent import Candidates, Model, descend
from ffsms_pin.opt.horizon.merit import Weights
from ffsms_pin.opt.horizon.spline import embedded

__all__ = [
    "EARLY_STAGES",
    "FINE_STAGES",
    "STRAIGHT_STAGE",
    "Stage",
    "distinct_best",
    "follow",
    "prefer_limits",
    "through",
    "tighten",
]

# Motions whose joints stay this near to each other everywhere [rad or m] have come together.
_APART = 0.05
# Weight of the true objective beside the smoothed merit when motions are compared: the smoothing hides cost.
_HONEST = 0.3
_TIGHTENINGS = 5
# Shares of tolerance, reach and margin at which a motion has landed.
_END, _TAIL, _LACK = 0.8, 0.975, 0.5
# How much softer the goal is made, in turn, where it and the limits cannot both be had.
_HOLDS = (1e-1, 1e-2, 1e-3, 1e-4)


@dataclass(frozen=True)
class Stage:
    """Keep the best motions, then iterate under these weights.

    Attributes
    ----------
    keep, iterations : int
    weights : Weights
    damping : float
        To start from.
    """

    keep: int
    iterations: int
    weights: Weights
    damping: float


def _weights(end: float, fade_speed: float, fade_distance: float, tie_break: float = 10.0) -> Weights:
    return Weights(end, max(1e3, 0.1 * end), tie_break, fade_speed, fade_distance)


# Made with every start, on the coarse spline. The end's weight grows from stage to stage, by ten each: a
# stiff end from the start would hold motions on the wrong way stage. The smoothing is taken back meanwhile.
EARLY_STAGES = (
    Stage(99, 3, _weights(1e2, 0.3, 0.03), 0.3),
    Stage(6, 2, _weights(1e2, 0.1, 0.03), 0.1),
)
_COARSE = Stage(4, 3, _weights(1e3, 0.03, 0.01), 0.03)
FINE_STAGES = (
    Stage(3, 3, _weights(1e4, 0.03, 0.002), 0.03),
    Stage(1, 5, _weights(1e5, 0.0, 0.0, 1.0), 0.03),
)
# For a straight move that ends at the target and shall go on doing so, whatever it costs.
STRAIGHT_STAGE = Stage(1, 10, _weights(1e6, 0.0, 0.0, 1.0), 1.0)


def distinct_best(model: Model, motions: Candidates, keep: int) -> Candidates:
    """The `keep` best motions; of those that came together only the best."""
    chosen: list[int] = []
    places = model.spline.travel.free @ motions.p
    for i in np.argsort(motions.at.merit + _HONEST * motions.at.objective, kind="stable"):
        if all(np.max(np.abs(places[i] - places[j])) > _APART for j in chosen):
            chosen.append(int(i))
        if len(chosen) == keep:
            break
    return motions.take(chosen)


def through(model: Model, p: FloatArray, stages: tuple[Stage, ...]) -> FloatArray:
    """Motions (S, M, n) taken through stages on one spline: the best of each, a few steps on.

    The last step of a stage is not judged: the next stage does that, under weights of its own.
    """
    for stage in stages:
        motions = Candidates.start(model, p, stage.weights, stage.damping)
        motions = distinct_best(model, motions, stage.keep)
        p = descend(model, motions, stage.weights, stage.iterations, judged=False).p
    return p


def follow(
    coarse: Model, fine: Model, pool: FloatArray, keep: tuple[int, int, int], repeats: int = 1
) -> Candidates:
    """From the pool of early motions (S, M, n) to a few on the fine spline, the best first.

    `keep` motions go on: on the coarse spline, on the fine one, and there to the end. `repeats`: how many
    times the usual iterations they make.
    """
    early, first, last = (
        replace(r, keep=k, iterations=repeats * r.iterations)
        for r, k in zip((_COARSE, *FINE_STAGES), keep, strict=True)
    )
    p = through(coarse, pool, (early,))
    p = embedded(coarse.spline, fine.spline, p, fine.problem.joint_rates)
    p = through(fine, p, (first,))
    motions = Candidates.start(fine, p, last.weights, last.damping)
    motions = distinct_best(fine, motions, last.keep)
    return distinct_best(fine, descend(fine, motions, last.weights, last.iterations), last.keep)


def tighten(model: Model, motion: Candidates) -> Candidates:
    """Make goal and limits stiffer where the terms pull harder than they do."""
    weights = FINE_STAGES[-1].weights
    for _ in range(_TIGHTENINGS):
        at = motion.at
        if at.limit_share[0] <= _LACK and at.end_share[0] <= _END and at.late_share[0] <= _TAIL:
            break
        weights = weights.stiffer()
        motion = descend(model, Candidates.start(model, motion.p, weights, motion.damping), weights, 4)
    return motion


def prefer_limits(model: Model, motion: Candidates) -> Candidates:
    """Where limits and goal cannot both be had: within the limits, as near to the goal as they allow."""
    stiff = FINE_STAGES[-1].weights
    for softer in _HOLDS:
        if motion.at.limit_share[0] <= _LACK:
            break
        weights = stiff._replace(end=softer * stiff.end, limits=10.0 * stiff.limits)
        motion = descend(model, Candidates.start(model, motion.p, weights, 0.03), weights, 15)
    return motion
