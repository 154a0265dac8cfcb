"""Bounds on the next joint rates that keep rate, acceleration and position limits for ever.

With w the rate at the step's end, a the acceleration limit and d the distance to the upper limit, room to
brake afterwards means dt (rate + w) / 2 + w^2 / (2 a) <= d for w >= 0: a quadratic in w. Where even w = 0
travels too far, w < 0 must turn round in time: rate^2 dt / (2 (rate - w)) <= d.
"""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray, frozen
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.limits.limit import Rows
from ffsms_pin.system import JointLimits

__all__ = ["RateBounds", "rate_bounds"]


class RateBounds:
    """Bounds on the next joint rates, prepared for a robot's limits.

    Parameters
    ----------
    limits : JointLimits
    """

    def __init__(self, limits: JointLimits) -> None:
        self._limits = np.array([limits.lower, limits.upper, limits.velocity, limits.acceleration])
        self._identity = frozen(np.eye(len(limits.upper)))

    def rows(self, joints: FloatArray, rates: FloatArray, dt: float) -> Rows:
        """The bounds as rows of a step."""
        return Rows(self._identity, *self.at(joints, rates, dt))

    def at(self, joints: FloatArray, rates: FloatArray, dt: float) -> tuple[FloatArray, FloatArray]:
        """As `rate_bounds`, for these limits."""
        lower, upper = kernel.rate_bounds(self._limits, joints, rates, dt)
        return lower, upper


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
