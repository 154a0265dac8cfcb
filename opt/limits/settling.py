"""Whether the arm could still stop with the base within its limits, which rows of one step do not see."""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.limits.step_state import StepState
from ffsms_pin.system.base_motion import advance

__all__ = ["BaseBounds", "settled"]

_BRAKED = 0.015  # share of a limit kept for the motion of an arm that brakes: half of what rows keep
# Of the way from braking to what the programme wants; and samples of an arm that brakes.
_SHARES = (0.5, 0.25, 0.1)
_STOPS = 5
_FASTEST = 1e6  # [rad/s^2] stands for no limit on an acceleration


class BaseBounds(Protocol):
    """What is limited: infinity is no limit.

    Attributes
    ----------
    attitude, final_attitude : float
        Turn from the start at any time, and at the end [rad].
    attitude_rate : float
        Angular speed [rad/s].
    translation : float
        Distance of the base's centre of mass from where it started [m].
    """

    @property
    def attitude(self) -> float: ...  # noqa: D102 - above
    @property
    def attitude_rate(self) -> float: ...  # noqa: D102
    @property
    def translation(self) -> float: ...  # noqa: D102
    @property
    def final_attitude(self) -> float: ...  # noqa: D102


def settled(limits: BaseBounds, step: StepState, rates: FloatArray, braking: FloatArray) -> FloatArray:
    """Joint rates (n,) for the step's end after which the arm can still stop with the base within its limits.

    A fast motion in the reaction null space needs the arm's acceleration to stay there, and the rows do not
    see how much. So what would happen if the arm stopped after this step is rolled out. Where that breaks a
    limit the rates go part of the way to braking, or all of it: that was safe one step ago.

    Parameters
    ----------
    limits : BaseBounds
    step : StepState
    rates, braking : ndarray, shape (n,)
        Wanted rates at the step's end, and those of braking [rad/s].
    """
    if min(limits.attitude, limits.translation, limits.attitude_rate) == math.inf:
        return rates
    if _furthest(limits, step, rates) <= 1.0:
        return rates
    # Where the limit is already broken, coming back must be possible.
    most = max(1.0, _furthest(limits, step, braking))
    for share in _SHARES:
        between = braking + share * (rates - braking)
        if _furthest(limits, step, between) <= most:
            return between
    return braking


def _furthest(limits: BaseBounds, step: StepState, end: FloatArray) -> float:
    """Largest share of the limits that is used if the arm goes to rates `end` and then stops."""
    sms, momentum, worst = step.sms, step.momentum, 0.0
    acceleration = np.minimum(sms.limits.acceleration, _FASTEST)
    stop = float(np.max(np.abs(end) / acceleration))
    q, _ = advance(sms, step.q, step.rates, (end - step.rates) / step.dt, step.dt, momentum, step.mode)
    slowing = -end / max(stop, 1e-12)
    for k in range(_STOPS + 1):
        worst = max(worst, _used(limits, step, q, end))
        if k < _STOPS and stop > 0.0:
            q, end = advance(sms, q, end, slowing, stop / _STOPS, momentum, step.mode)
    return worst / (1.0 - _BRAKED)


def _used(limits: BaseBounds, step: StepState, q: FloatArray, rates: FloatArray) -> float:
    """Largest share of the limits that is used at one state."""
    start, now = pin.XYZQUATToSE3(step.base_start), pin.XYZQUATToSE3(q[:7])
    com: Any = step.sms.base_com
    turn = float(np.linalg.norm(pin.log3(start.rotation.T @ now.rotation)))
    shift = float(np.linalg.norm(now.act(com) - start.act(com)))
    used = max(turn / limits.attitude, shift / limits.translation)
    if limits.attitude_rate < math.inf:
        spin = step.sms.velocity(q, rates, step.momentum, step.mode)[3:6]
        used = max(used, float(np.linalg.norm(spin)) / limits.attitude_rate)
    return used
