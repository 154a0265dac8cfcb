"""Successive halving: many motions for a few iterations, the best of them for more, on a finer spline.

Reference: K. Jamieson, A. Talwalkar, "Non-stochastic best arm identification and hyperparameter
optimization", 2016 (the idea; its bandit setting does not matter here).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

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
    "run",
    "tighten",
]

# Motions whose joints stay this near to each other everywhere [rad or m] have come together.
_APART = 0.05
# Weight of the true objective beside the smoothed merit when motions are compared: the smoothing hides cost.
_HONEST = 0.3
# Weight, in that, of the square of the largest lack of a clearance, in margins beyond the first. A short way
# through a body weighs little over time, and a descent does not find out of it: it pushes to both sides.
_THROUGH = 1.0
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
    damping : float or None
        To start from; None: as the last stage left it.
    """

    keep: int
    iterations: int
    weights: Weights
    damping: float | None = None


def _weights(end: float, fade_speed: float, fade_distance: float, tie_break: float = 10.0) -> Weights:
    return Weights(end, max(1e3, 0.1 * end), tie_break, fade_speed, fade_distance)


# Made with every start, on the coarse spline. The end's weight grows from stage to stage, by ten each: a
# stiff end from the start would hold motions on the wrong way stage. The smoothing is taken back meanwhile.
EARLY_STAGES = (
    Stage(99, 3, _weights(1e2, 0.3, 0.03), 0.3),
    Stage(6, 2, _weights(1e2, 0.1, 0.03)),
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
    beyond = np.maximum(motions.at.blocked_share - 1.0, 0.0)
    worth = motions.at.merit + _HONEST * motions.at.objective + _THROUGH * beyond**2
    for i in np.argsort(worth, kind="stable"):
        if all(np.max(np.abs(places[i] - places[j])) > _APART for j in chosen):
            chosen.append(int(i))
        if len(chosen) == keep:
            break
    return motions.take(chosen)


def run(
    model: Model, motions: Candidates, stages: tuple[Stage, ...], weights: Weights | None = None
) -> Candidates:
    """Stages on one spline; `weights` are those under which the motions were linearised, if any."""
    for r in stages:
        if weights is not None:
            motions = distinct_best(model, motions, r.keep)
        if r.weights is not weights:
            damping = motions.damping if r.damping is None else r.damping
            motions, weights = Candidates.start(model, motions.p, r.weights, damping), r.weights
        motions = descend(model, motions, r.weights, r.iterations)
    return motions


def follow(
    coarse: Model, fine: Model, pool: Candidates, keep: tuple[int, int, int], repeats: int = 1
) -> Candidates:
    """From the pool of early motions to a few on the fine spline, the best first.

    `keep` motions go on: on the coarse spline, on the fine one, and there to the end. `repeats`: how many
    times the usual iterations they make.
    """
    stages = (
        replace(r, keep=k, iterations=repeats * r.iterations)
        for r, k in zip((_COARSE, *FINE_STAGES), keep, strict=True)
    )
    early, first, last = stages
    motions = run(coarse, pool, (early,), EARLY_STAGES[-1].weights)
    kept = distinct_best(coarse, motions, first.keep).p
    p = embedded(coarse.spline, fine.spline, kept, fine.problem.joint_rates)
    motions = Candidates.start(fine, p, first.weights, first.damping or 0.03)
    return distinct_best(fine, run(fine, motions, (first, last), first.weights), last.keep)


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
