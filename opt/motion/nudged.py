"""Motions in which one thing has moved a little and all else stays: what a slope of a residual means."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.motion.motions import HeldMotions, Motions
from ffsms_pin.system.batch.stacks import apply, exp3

__all__ = ["by_differences", "difference", "movers", "nudged"]

_STEP = 1e-6  # [m, rad, 1/s of them] what things move by in a difference

_SHIFTED = {
    "by_tip": "end_effector",
    "by_velocity": "relative_velocity",
    "by_spin": "spin",
    "by_base": "base_from_com",
    "by_base_spin": "base_spin",
}
_FIELDS = {"by_joints": "joints", "by_rates": "rates", "by_accelerations": "accelerations"}


@dataclass(frozen=True, eq=False, kw_only=True)
class _Held(HeldMotions):
    """All that is worked out from other values is given, so that these can change alone."""

    entropy_and_slope: tuple[FloatArray, FloatArray]


def movers(motions: Motions) -> Iterator[tuple[str, int]]:
    """Everything that may move, by the names of slopes, and its components."""
    for name in (*_SHIFTED, "by_turn", "by_base_turn"):
        yield from ((name, i) for i in range(3))
    yield "by_entropy", 0
    for name in _FIELDS:
        yield from ((name, i) for i in range(motions.stack.n))


def nudged(motions: Motions, name: str, i: int, by: float) -> Motions:
    """The motions with component i of what is called `name` moved, at all instants."""
    values: dict[str, Any] = {one.name: getattr(motions, one.name) for one in fields(_Held)}
    values["evaluated"] = motions.arm
    unit = np.zeros(3)
    unit[i % 3] = by
    turn = exp3(unit)[..., None, None]
    if name in _SHIFTED:
        values[_SHIFTED[name]] = values[_SHIFTED[name]] + unit[:, None, None]
    elif name == "by_turn":
        values["attitude"] = apply(turn, motions.attitude)
    elif name == "by_base_turn":
        values["base_attitude"] = apply(turn, motions.base_attitude)
    elif name == "by_entropy":
        values["entropy_and_slope"] = (motions.entropy + by, motions.entropy_slope)
    else:
        moved = getattr(motions, _FIELDS[name]).copy()
        moved[i] += by
        values[_FIELDS[name]] = moved
        if name == "by_joints":
            values["evaluated"] = None
    return _Held(**values)


def difference(formula: Callable[[Motions], FloatArray], motions: Motions, name: str, i: int) -> FloatArray:
    """A formula's slope by component i of what is called `name`; zero where it is not finite."""
    ahead, behind = (formula(nudged(motions, name, i, by)) for by in (_STEP, -_STEP))
    apart = np.subtract(ahead, behind, out=np.zeros_like(ahead), where=np.isfinite(ahead))
    return apart / (2.0 * _STEP)


def by_differences(formula: Callable[[Motions], FloatArray], motions: Motions) -> dict[str, FloatArray]:
    """Slopes of a formula by everything that may move it, by central differences.

    Parameters
    ----------
    formula : callable
        Of motions, to an array (S, K) or (c, S, K).
    motions : Motions
    """
    found: dict[str, list[FloatArray]] = {}
    for name, i in movers(motions):
        found.setdefault(name, []).append(difference(formula, motions, name, i))
    slopes = {name: np.stack(one, axis=one[0].ndim - 2) for name, one in found.items() if np.any(one)}
    if "by_entropy" in slopes:
        slopes["by_entropy"] = slopes["by_entropy"].squeeze(slopes["by_entropy"].ndim - 3)
    return slopes
