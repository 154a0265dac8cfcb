"""Bounds on the next joint rates that keep rate, acceleration and position limits for ever.

With w the rate at the step's end, a the acceleration limit and d the distance to the upper limit, room to
brake afterwards means dt (rate + w) / 2 + w^2 / (2 a) <= d for w >= 0: a quadratic in w. Where even w = 0
travels too far, w < 0 must turn round in time: rate^2 dt / (2 (rate - w)) <= d.
"""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray, frozen
from ffsms_pin.opt.limits.limit import UNBOUNDED, Rows
from ffsms_pin.system import JointLimits

__all__ = ["RateBounds", "rate_bounds"]

_FASTEST = 1e6  # [rad/s^2] stands for no limit on an acceleration: finite, so that sums stay numbers
_UP_AND_DOWN = np.array([[1.0], [-1.0]])


class RateBounds:
    """Bounds on the next joint rates, prepared for a robot's limits.

    Parameters
    ----------
    limits : JointLimits
    """

    def __init__(self, limits: JointLimits) -> None:
        self._velocity = np.minimum(limits.velocity, UNBOUNDED)
        self._acceleration = np.minimum(limits.acceleration, _FASTEST)
        self._twice = 2.0 * self._acceleration
        # Both directions in one: row 0 looks up, row 1 looks down as if up.
        self._walls = np.array([limits.upper, -limits.lower])
        self._identity = frozen(np.eye(len(limits.upper)))

    def rows(self, joints: FloatArray, rates: FloatArray, dt: float) -> Rows:
        """The bounds as rows of a step."""
        return Rows(self._identity, *self.at(joints, rates, dt))

    def at(self, joints: FloatArray, rates: FloatArray, dt: float) -> tuple[FloatArray, FloatArray]:
        """As `rate_bounds`, for these limits."""
        moving = _UP_AND_DOWN * rates
        room = np.maximum(self._walls - _UP_AND_DOWN * joints, 0.0)
        change = dt * self._acceleration
        greatest = np.minimum(self._stoppable_rate(room, moving, dt), self._velocity)
        # The acceleration limit comes last: it is never broken.
        greatest = np.maximum(np.minimum(greatest, moving + change), moving - change)
        # A joint that can brake before neither of two near limits has crossed bounds; then the lower one is
        # both.
        lower, upper = -greatest[1], greatest[0]
        return lower, np.maximum(lower, upper)

    def _stoppable_rate(self, room: FloatArray, rate: FloatArray, dt: float) -> FloatArray:
        """Greatest rates at the step's end towards limits that are `room` away."""
        half = (0.5 * dt) * self._acceleration
        square = half * half + self._twice * (room - (0.5 * dt) * rate)
        greatest: FloatArray = np.sqrt(np.maximum(square, 0.0)) - half
        if greatest.min() >= 0.0:
            return greatest
        turning = np.maximum(rate, 0.0)
        back = np.minimum(rate - turning * turning * dt / (2.0 * np.maximum(room, 1e-300)), 0.0)
        return np.where(greatest < 0.0, back, greatest)


def rate_bounds(
    joints: FloatArray, rates: FloatArray, limits: JointLimits, dt: float
) -> tuple[FloatArray, FloatArray]:
    """Least and greatest joint rates (n,) [rad/s] at the end of a step of constant acceleration.

    A rate between the bounds keeps the rate and acceleration limits during the step, and the position limits
    during the step and, since it leaves room to brake at full acceleration, ever after. The interval is never
    empty for a state that itself has room to brake. For any other state the acceleration limit is kept, and
    the other limits as nearly as it allows.

    Parameters
    ----------
    joints, rates : ndarray, shape (n,)
        At the step's start [rad], [rad/s].
    limits : JointLimits
    dt : float
        [s]
    """
    return RateBounds(limits).at(joints, rates, dt)
