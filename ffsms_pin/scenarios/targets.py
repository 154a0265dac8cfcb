"""The goal that the table [target] describes: a place, a pose, or either of them in motion."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.scenarios.tables import DEGREES

__all__ = ["Straight", "goal_of"]


@dataclass(frozen=True)
class Straight:
    """A place that moves at a constant velocity, inertial axes.

    Attributes
    ----------
    position : tuple of float
        At the start [m].
    velocity : tuple of float
        [m/s]
    rpy : tuple of float or None
        Attitude as roll, pitch and yaw [rad]; None where any will do.
    """

    position: tuple[float, ...]
    velocity: tuple[float, ...]
    rpy: tuple[float, ...] | None = None

    def __call__(self, t: float) -> Any:
        """The position (3,) [m] or the pose (pinocchio.SE3) at a time [s]."""
        place = np.array(self.position) + t * np.array(self.velocity)
        return place if self.rpy is None else pin.SE3(pin.rpy.rpyToMatrix(np.array(self.rpy)), place)


def goal_of(target: Mapping[str, Any]) -> Any:
    """What `opt.Problem` takes as its goal, from the table [target]."""
    rpy = target.get("rpy")
    if "rpy" + DEGREES in target:
        rpy = tuple(math.radians(angle) for angle in target["rpy" + DEGREES])
    velocity = target.get("velocity", (0.0, 0.0, 0.0))
    path = Straight(target["position"], velocity, rpy)
    return path if any(velocity) else path(0.0)
