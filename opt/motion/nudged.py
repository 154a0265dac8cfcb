"""Motions in which one thing has moved a little and all else stays: what a slope of a residual means."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.motion.feature import Feature
from ffsms_pin.opt.motion.motions import Motions
from ffsms_pin.system.batch.stacks import apply, exp3

__all__ = ["by_differences", "difference", "movers", "nudged"]

_STEP = 1e-6  # [m, rad, 1/s of them] what things move by in a difference

# What is worked out from other values is held fast, so that these can change alone.
_HELD = ("end_effector", "attitude", "relative_velocity", "base_spin", "spin", "base_from_com", "_entropy")
_SHIFTED = {
    "by_tip": "end_effector",
    "by_velocity": "relative_velocity",
    "by_spin": "spin",
    "by_base": "base_from_com",
    "by_base_spin": "base_spin",
}
_FIELDS = {"by_joints": "joints", "by_rates": "rates", "by_accelerations": "accelerations"}


def movers(motions: Motions) -> Iterator[tuple[str, int]]:
    """Everything that may move, by the names of slopes, and its components."""
    for name in (*_SHIFTED, "by_turn", "by_base_turn"):
        yield from ((name, i) for i in range(3))
    yield "by_entropy", 0
    for name in _FIELDS:
        yield from ((name, i) for i in range(motions.stack.n))


def nudged(motions: Motions, name: str, i: int, by: float) -> Motions:
    """The motions with component i of what is called `name` moved, at all instants."""
    changed: dict[str, Any] = {}
    held = {key: getattr(motions, key) for key in _HELD}
    unit = np.zeros(3)
    unit[i % 3] = by
    turn = exp3(unit)[..., None, None]
    if name in _SHIFTED:
        held[_SHIFTED[name]] = held[_SHIFTED[name]] + unit[:, None, None]
    elif name == "by_turn":
        held["attitude"] = apply(turn, held["attitude"])
    elif name == "by_base_turn":
        changed["base_attitude"] = apply(turn, motions.base_attitude)
    elif name == "by_entropy":
        held["_entropy"] = (held["_entropy"][0] + by, held["_entropy"][1])
    else:
        value = getattr(motions, _FIELDS[name]).copy()
        value[i] += by
        changed[_FIELDS[name]] = value
        if name == "by_joints":
            changed["arm"] = motions.stack.evaluate(value)
    result = replace(motions, **changed)
    result.__dict__.update(held)
    return result


def difference(formula: Callable[[Motions], FloatArray], motions: Motions, name: str, i: int) -> FloatArray:
    """A formula's slope by component i of what is called `name`; zero where it is not finite."""
    ahead, behind = (formula(nudged(motions, name, i, by)) for by in (_STEP, -_STEP))
    apart = np.subtract(ahead, behind, out=np.zeros_like(ahead), where=np.isfinite(ahead))
    return apart / (2.0 * _STEP)


def by_differences(formula: Callable[[Motions], FloatArray], motions: Motions) -> Feature:
    """A formula without slopes, with slopes by everything that may move it, by central differences.

    Parameters
    ----------
    formula : callable
        Of motions, to an array (S, K) or (c, S, K).
    motions : Motions
    """
    value = formula(motions)
    components = value.ndim - 2
    found: dict[str, list[FloatArray]] = {}
    for name, i in movers(motions):
        found.setdefault(name, []).append(difference(formula, motions, name, i))
    slopes = {name: np.stack(one, axis=components) for name, one in found.items()}
    slopes["by_entropy"] = slopes["by_entropy"].squeeze(components)
    return Feature(value, {name: slope for name, slope in slopes.items() if slope.any()})
