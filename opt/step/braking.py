"""What a step falls back to: braking, within the limits that never give way."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.limits.limit import UNBOUNDED, Rows
from ffsms_pin.opt.limits.step_state import StepState

__all__ = ["braking", "hard_bounds", "within"]

_MOST = 1e6  # [rad/s^2] stands for no limit on an acceleration


def braking(step: StepState) -> FloatArray:
    """Rates (n,) at the step's end of an arm that brakes as fast as its joints may [rad/s].

    All of them in the same time: so what cancels in the base's motion goes on to cancel.
    """
    acceleration = np.minimum(step.sms.limits.acceleration, _MOST)
    longest = float(np.max(np.abs(step.rates) / acceleration))
    slower: FloatArray = step.rates * max(0.0, 1.0 - step.dt / max(longest, 1e-12))
    return slower


def hard_bounds(rows: Sequence[Rows], n: int) -> tuple[FloatArray, FloatArray]:
    """Bounds (n,) on the joint rates that rows state one by one (G = 1) and that never give way [rad/s]."""
    found = [(low, up) for G, low, up, give in rows if give == 0.0 and _is_identity(G)]
    if not found:
        return np.full(n, -UNBOUNDED), np.full(n, UNBOUNDED)
    lower, upper = found[0]
    for low, up in found[1:]:
        lower, upper = np.maximum(lower, low), np.minimum(upper, up)
    return lower, upper


def _is_identity(G: FloatArray) -> bool:
    # The zeros first: they tell nearly always, at no cost.
    n = G.shape[1]
    return len(G) == n == np.count_nonzero(G) and bool((G.diagonal() == 1.0).all())


def within(rates: FloatArray, bounds: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Rates (n,), or the nearest to them within bounds."""
    return np.minimum(np.maximum(rates, bounds[0]), bounds[1])
