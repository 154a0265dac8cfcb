"""Rows of a step that bring a frame to a place in time.

Far from the place and early the frame may do what it likes. The way that is left must shrink once it is as
long as what the arm is trusted to make up in the time that is left; a frame that is further away goes on as
fast as it takes to be there in time.
"""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.limits.limit import UNBOUNDED, Rows

__all__ = ["approach_row"]

_RATE = 2.0  # [1/s] What the way is too long by shrinks at this rate.
_HURRY = 1.5  # times the mean speed of what is left: the most that a frame far away is asked for
_BEFORE = 10  # steps before it is due the frame should be there


def approach_row(
    way: FloatArray,
    J: FloatArray,
    rates: FloatArray,
    drift: FloatArray,
    allowed: float,
    trusted: float,
    time_left: float,
    dt: float,
) -> Rows:
    """One row for a way, or a turn, that is left.

    Parameters
    ----------
    way : ndarray, shape (3,)
        From the frame to its place [m], or a rotation vector [rad].
    J : ndarray, shape (3, n)
        Velocity of the frame a joint rate, the base reacting.
    rates : ndarray, shape (n,)
        At the step's start [rad/s].
    drift : ndarray, shape (3,)
        Velocity of the frame that the total momentum gives.
    allowed : float
        How long the way may be in the end.
    trusted : float
        How fast the arm is trusted to make it up [m/s or rad/s].
    time_left, dt : float
        Until it is due, and the step [s].
    """
    way = way - dt * (J @ rates + drift)  # where the step ends
    length = float(np.linalg.norm(way))
    unit = way / max(length, 1e-12)
    spare = max(time_left - _BEFORE * dt, 0.0)
    closing = _RATE * (length - allowed - trusted * spare)
    if spare > 0.0:
        closing = min(closing + trusted, _HURRY * (length - allowed) / max(spare, 2.0 * dt))
    least = closing - float(unit @ drift)
    return Rows((unit @ J)[None], np.array([least]), np.array([UNBOUNDED]), give=1.0)
