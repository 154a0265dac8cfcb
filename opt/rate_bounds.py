"""Bounds on the next joint rates that keep rate, acceleration and position limits for ever."""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.system import JointLimits

__all__ = ["rate_bounds"]


def rate_bounds(
    positions: FloatArray, rates: FloatArray, limits: JointLimits, dt: float
) -> tuple[FloatArray, FloatArray]:
    """Least and greatest joint rates at the end of a step of constant acceleration.

    A rate between the bounds keeps the rate and acceleration limits during the step, and the position limits
    during the step and, since it leaves room to brake at full acceleration, ever after. The interval is never
    empty for a state that itself has room to brake.

    With w the rate at the step's end, a the acceleration limit and d the distance to the upper limit, room
    to brake afterwards means dt (rate + w) / 2 + w^2 / (2 a) <= d for w >= 0: a quadratic in w. Where even
    w = 0 travels too far, w < 0 must turn round in time: rate^2 dt / (2 (rate - w)) <= d.

    Parameters
    ----------
    positions, rates : ndarray, shape (n,)
        At the start of the step [rad], [rad/s].
    limits : JointLimits
    dt : float
        [s]

    Returns
    -------
    lower, upper : ndarray, shape (n,)
        [rad/s]
    """
    a = limits.acceleration
    least, greatest = rates - dt * a, rates + dt * a
    upper = _towards(limits.upper - positions, rates, a, dt)
    lower = -_towards(positions - limits.lower, -rates, a, dt)
    # The order matters: an acceleration limit is never broken, whatever rounding does to the others.
    upper = np.minimum(np.minimum(limits.velocity, upper), greatest)
    lower = np.maximum(np.maximum(-limits.velocity, lower), least)
    return np.minimum(lower, greatest), np.maximum(upper, least)


def _towards(distance: FloatArray, rate: FloatArray, a: FloatArray, dt: float) -> FloatArray:
    """Greatest rate at the step's end towards a limit that is `distance` away."""
    if np.isinf(distance).all():
        return np.full_like(rate, np.inf)
    half = (0.5 * dt) * a
    # Clipped, so that a joint without limits or at its limit stays finite.
    room = np.minimum(np.maximum(distance, 0.0), 1e6)
    greatest = np.sqrt(np.maximum(half * half + 2.0 * a * (room - (0.5 * dt) * rate), 0.0)) - half
    turning = greatest < 0.0
    if turning.any():
        moving = np.maximum(rate, 0.0)
        turn = rate - moving * moving * dt / (2.0 * np.maximum(room, 1e-300))
        greatest = np.where(turning, np.minimum(turn, 0.0), greatest)
    return greatest
