"""What a step falls back to: braking, within the limits that never give way."""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.limits.step_state import StepState

__all__ = ["braking", "within"]

_MOST = 1e6  # [rad/s^2] stands for no limit on an acceleration


def braking(step: StepState) -> FloatArray:
    """Rates (n,) at the step's end of an arm that brakes as fast as its joints may [rad/s].

    All of them in the same time: so what cancels in the base's motion goes on to cancel.
    """
    acceleration = np.minimum(step.sms.limits.acceleration, _MOST)
    longest = float(np.max(np.abs(step.rates) / acceleration))
    slower: FloatArray = step.rates * max(0.0, 1.0 - step.dt / max(longest, 1e-12))
    return slower


def within(rates: FloatArray, bounds: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Rates (n,), or the nearest to them within bounds."""
    return np.minimum(np.maximum(rates, bounds[0]), bounds[1])
