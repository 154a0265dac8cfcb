"""What a step falls back to: braking, within the limits that never give way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.limits.limit import Limit
from ffsms_pin.opt.motion.at_step import arm_stack
from ffsms_pin.opt.motion.rollout import rolled_out
from ffsms_pin.opt.parts.reading import violation_of
from ffsms_pin.opt.step.state import StepState
from ffsms_pin.system.base_motion import advance

__all__ = ["braking", "stoppable", "within"]

_MOST = 1e6  # [rad/s^2] stands for no limit on an acceleration
_SHARES = (0.5, 0.25, 0.1)  # of the way from braking to what the programme wants
_STOPS = 5  # steps of an arm that stops


def braking(step: StepState) -> FloatArray:
    """Rates (n,) at the step's end of an arm that brakes as fast as its joints may [rad/s].

    All of them in the same time: so what cancels in the base's motion goes on to cancel.
    """
    slower: FloatArray = step.rates * max(0.0, 1.0 - step.dt / max(_stop(step, step.rates), 1e-12))
    return slower


def within(rates: FloatArray, bounds: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Rates (n,), or the nearest to them within bounds."""
    return np.minimum(np.maximum(rates, bounds[0]), bounds[1])


def stoppable(limits: Sequence[Limit], step: StepState, rates: FloatArray, slower: FloatArray) -> FloatArray:
    """Joint rates (n,) for the step's end after which the arm can still stop with limits kept.

    What would happen if it stopped after this step is rolled out. Where that breaks a limit the rates go part
    of the way to braking, or all of it: that was safe one step ago.

    Parameters
    ----------
    limits : sequence of Limit
    step : StepState
    rates, slower : ndarray, shape (n,)
        Wanted rates at the step's end, and those of braking [rad/s].
    """
    if not _broken(limits, step, rates).any():
        return rates
    most = _broken(limits, step, slower)  # where a limit is broken already, coming back must be possible
    for share in _SHARES:
        between = slower + share * (rates - slower)
        if (_broken(limits, step, between) <= most).all():
            return between
    return slower


def _broken(limits: Sequence[Limit], step: StepState, end: FloatArray) -> FloatArray:
    """By how much each limit is broken if the arm goes to rates `end` and then stops."""
    sms, momentum = step.sms, step.momentum
    q, _ = advance(sms, step.q, step.rates, (end - step.rates) / step.dt, step.dt, momentum, step.mode)
    slowing = np.linspace(1.0, 0.0, _STOPS + 1)[:, None] * end
    dt, start = max(_stop(step, end), step.dt) / _STOPS, pin.XYZQUATToSE3(step.base_start)
    motion = replace(
        rolled_out(sms, arm_stack(sms, step.mode), q, slowing, dt, momentum, 1.0),
        base_start=start.act(sms.base_com),
        rotation_start=start.rotation,
        wheels=step.wheels,
        wheel_total=step.features.motions.wheel_total,
    )
    return np.array([violation_of(limit, motion).amount for limit in limits])


def _stop(step: StepState, rates: FloatArray) -> float:
    """In what time the arm may stop from joint rates [s]."""
    return float(np.max(np.abs(rates) / np.minimum(step.sms.limits.acceleration, _MOST)))
