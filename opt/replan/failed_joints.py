"""A robot some of whose joints have failed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.system import SpaceManipulator

__all__ = ["without"]

_STILL = 1e-9  # [rad/s, rad/s^2] what a failed joint may still do in a step


def without(sms: SpaceManipulator, failed: NDArray[np.bool_]) -> SpaceManipulator:
    """The robot with joints that do not move."""
    limits = sms.limits
    velocity, acceleration = limits.velocity.copy(), limits.acceleration.copy()
    velocity[failed] = acceleration[failed] = _STILL
    return sms.with_limits(replace(limits, velocity=velocity, acceleration=acceleration))
