"""Bounds on the next joint rates that keep rate, acceleration and position limits for ever."""

from __future__ import annotations

import math

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.system import JointLimits

__all__ = ["UNBOUNDED", "RateBounds", "rate_bounds"]

# What stands for no limit: on a rate, an acceleration and a distance. Finite, so that sums stay numbers.
UNBOUNDED = 1e20
_FASTEST, _FARTHEST = 1e6, 1e6


class RateBounds:
    """Least and greatest joint rates at the end of a step of constant acceleration.

    A rate between the bounds keeps the rate and acceleration limits during the step, and the position limits
    during the step and, since it leaves room to brake at full acceleration, ever after. The interval is never
    empty for a state that itself has room to brake.

    With w the rate at the step's end, a the acceleration limit and d the distance to the upper limit, room
    to brake afterwards means dt (rate + w) / 2 + w^2 / (2 a) <= d for w >= 0: a quadratic in w. Where even
    w = 0 travels too far, w < 0 must turn round in time: rate^2 dt / (2 (rate - w)) <= d.

    Parameters
    ----------
    limits : JointLimits
    dt : float
        [s]
    """

    def __init__(self, limits: JointLimits, dt: float) -> None:
        self._dt = dt
        velocity = np.minimum(limits.velocity, UNBOUNDED)
        acceleration = np.minimum(limits.acceleration, _FASTEST)
        # Further away than this a joint can brake from any rate within its limit: no position limit counts.
        clear = 1.001 * (dt * velocity + velocity**2 / (2.0 * acceleration))
        # So it is with a joint between these.
        low, high = limits.lower + clear, limits.upper - clear
        columns = (low, high, velocity, dt * acceleration, limits.lower, limits.upper, acceleration)
        self._joints = list(zip(*(column.tolist() for column in columns), strict=True))

    def of(self, positions: list[float], rates: list[float]) -> tuple[list[float], list[float]]:
        """Lower and upper bounds [rad/s] at positions and rates of n joints at the start of the step."""
        # Joint by joint, in plain numbers: a few joints are done before arrays would be set up.
        lower, upper = [], []
        for q, rate, joint in zip(positions, rates, self._joints, strict=True):
            least, greatest = self._of_joint(q, rate, joint)
            lower.append(least)
            upper.append(greatest)
        return lower, upper

    def allow(self, positions: list[float], rates: list[float], wanted: list[float]) -> bool:
        """Whether wanted rates are within the bounds: the same answer, mostly without working them out."""
        for q, rate, w, joint in zip(positions, rates, wanted, self._joints, strict=True):
            low, high, v, change, _, _, _ = joint
            if low <= q <= high and -v <= rate <= v:
                if not (-v <= w <= v and rate - change <= w <= rate + change):
                    return False
            else:
                least, greatest = self._of_joint(q, rate, joint)
                if not least <= w <= greatest:
                    return False
        return True

    def _of_joint(self, q: float, rate: float, joint: tuple[float, ...]) -> tuple[float, float]:
        low, high, v, change, lower, upper, a = joint
        least, greatest = rate - change, rate + change
        most, fewest = v, -v
        slow = -v <= rate <= v
        if not slow or q > high:
            most = min(v, _towards(upper - q, rate, a, self._dt))
        if not slow or q < low:
            fewest = max(-v, -_towards(q - lower, -rate, a, self._dt))
        # An acceleration limit is never broken, whatever rounding does to the others.
        return min(max(fewest, least), greatest), max(min(most, greatest), least)


def rate_bounds(
    positions: FloatArray, rates: FloatArray, limits: JointLimits, dt: float
) -> tuple[FloatArray, FloatArray]:
    """Least and greatest joint rates (n,) [rad/s] at the end of a step; see `RateBounds`."""
    lower, upper = RateBounds(limits, dt).of(positions.tolist(), rates.tolist())
    return np.array(lower), np.array(upper)


def _towards(distance: float, rate: float, a: float, dt: float) -> float:
    """Greatest rate at the step's end towards a limit that is `distance` away."""
    # Clipped, so that a joint without limits or at its limit stays finite.
    room = min(max(distance, 0.0), _FARTHEST)
    half = 0.5 * dt * a
    greatest = math.sqrt(max(half * half + 2.0 * a * (room - 0.5 * dt * rate), 0.0)) - half
    if greatest < 0.0:
        moving = max(rate, 0.0)
        return min(rate - moving * moving * dt / (2.0 * max(room, 1e-300)), 0.0)
    return greatest
