"""Successive halving: many motions for a few iterations, the best of them for more, on a finer spline.

Reference: K. Jamieson, A. Talwalkar, "Non-stochastic best arm identification and hyperparameter
optimization", 2016 (the idea; its bandit setting does not matter here).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ffsms_pin.opt.horizon.base_residual import BASE_MARGIN
from ffsms_pin.opt.horizon.descent import Motions, Workbench, descend
from ffsms_pin.opt.horizon.linearisation import CLEARANCE_MARGIN
from ffsms_pin.opt.horizon.spline import embedding
from ffsms_pin.opt.horizon.weights import Weights

__all__ = ["ARRIVAL", "EARLY", "LATE", "STIFF", "Round", "best", "follow", "hold_base", "land", "run"]

# [m] At the deadline: a twentieth of the paper's r_th.
ARRIVAL = 1e-3
# [m] The last tenth is held a little within the paper's r_th = 0.02 m.
_TAIL = 0.0195
# Motions whose joints stay this near to each other everywhere [rad or m] have come together.
_APART = 0.05
# Weight of the true cost beside the smoothed merit when motions are compared: the smoothing hides cost.
_HONEST = 0.3
_LANDINGS = 5
# How much softer the end is made, in turn, where it and the base limits cannot both be had.
_HOLDS = (1e-1, 1e-2, 1e-3, 1e-4)


@dataclass(frozen=True)
class Round:
    """Keep the best motions, then iterate under these weights.

    Attributes
    ----------
    keep, iterations : int
    weights : Weights
    damping : float or None
        To start from; None: as the last round left it.
    """

    keep: int
    iterations: int
    weights: Weights
    damping: float | None = None


def _weights(end: float, slow: float, close: float, rough: float = 1e-4) -> Weights:
    return Weights(end, 0.1 * end, max(1e3, 0.1 * end), rough, slow, close, base=1e-4 * end)


# Made with every start, on the coarse spline. The end's weight grows from round to round, by ten each: a
# stiff end from the start would hold motions on the wrong way round. The smoothing is taken back meanwhile.
EARLY = (
    Round(99, 3, _weights(1e2, 0.3, 0.03), 0.3),
    Round(6, 2, _weights(1e2, 0.1, 0.03)),
)
_COARSE = Round(4, 3, _weights(1e3, 0.03, 0.01), 0.03)
LATE = (
    Round(3, 3, _weights(1e4, 0.03, 0.002), 0.03),
    Round(1, 5, _weights(1e5, 0.0, 0.0, 1e-5), 0.03),
)
# For a straight move that ends at the target and shall go on doing so, whatever it costs.
STIFF = Round(1, 10, _weights(1e6, 0.0, 0.0, 1e-5), 1.0)


def best(bench: Workbench, motions: Motions, keep: int) -> Motions:
    """The `keep` best motions; of those that came together only the best."""
    chosen: list[int] = []
    places = bench.spline.travel @ motions.p
    for i in np.argsort(motions.at.merit + _HONEST * motions.at.cost, kind="stable"):
        if all(np.max(np.abs(places[i] - places[j])) > _APART for j in chosen):
            chosen.append(int(i))
        if len(chosen) == keep:
            break
    return motions.take(chosen)


def run(
    bench: Workbench, motions: Motions, rounds: tuple[Round, ...], weights: Weights | None = None
) -> Motions:
    """Rounds on one spline; `weights` are those under which the motions were linearised, if any."""
    for r in rounds:
        if weights is not None:
            motions = best(bench, motions, r.keep)
        if r.weights is not weights:
            damping = motions.damping if r.damping is None else r.damping
            motions, weights = Motions.start(bench, motions.p, r.weights, damping), r.weights
        motions = descend(bench, motions, r.weights, r.iterations)
    return motions


def follow(
    coarse: Workbench, fine: Workbench, pool: Motions, keep: tuple[int, int, int], patience: int = 1
) -> Motions:
    """From the pool of early motions to a few on the fine spline, the best first.

    `keep` motions go on: on the coarse spline, on the fine one, and there to the end. `patience`: how many
    times the usual iterations they make.
    """
    rounds = (
        replace(r, keep=k, iterations=patience * r.iterations)
        for r, k in zip((_COARSE, *LATE), keep, strict=True)
    )
    early, first, last = rounds
    motions = run(coarse, pool, (early,), EARLY[-1].weights)
    p = embedding(coarse.spline, fine.spline) @ best(coarse, motions, first.keep).p
    motions = Motions.start(fine, p, first.weights, first.damping or 0.03)
    return best(fine, run(fine, motions, (first, last), first.weights), last.keep)


def land(bench: Workbench, motion: Motions) -> Motions:
    """Make the end, the tail and the clearances stiffer where the cost pulls harder than they do."""
    weights, margin = LATE[-1].weights, 0.5 * CLEARANCE_MARGIN * bench.task.length
    for _ in range(_LANDINGS):
        at = motion.at
        held = at.base_lack[0] <= 0.5 * BASE_MARGIN
        if held and at.error[0] <= 0.8 * ARRIVAL and at.tail[0] <= _TAIL and at.lack[0] <= margin:
            break
        weights = replace(
            weights,
            end=10.0 * weights.end,
            tail=10.0 * weights.tail,
            clear=10.0 * weights.clear,
            base=10.0 * weights.base,
        )
        motion = descend(bench, Motions.start(bench, motion.p, weights, motion.damping), weights, 4)
    return motion


def hold_base(bench: Workbench, motion: Motions) -> Motions:
    """Where base limits and target cannot both be had: within the limits, as near as they allow."""
    stiff = LATE[-1].weights
    for softer in _HOLDS:
        if motion.at.base_lack[0] <= 0.5 * BASE_MARGIN:
            break
        weights = replace(stiff, end=softer * stiff.end, tail=softer * stiff.tail, base=10.0 * stiff.base)
        motion = descend(bench, Motions.start(bench, motion.p, weights, 0.03), weights, 15)
    return motion
