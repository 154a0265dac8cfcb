"""How far the points that a joint carries can be from it: a bound on how fast it can move them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray

__all__ = ["joint_reach"]


def joint_reach(model: Any, carrier: int, beyond: float) -> FloatArray:
    """Greatest speeds (n,) that the joints can give a point, relative to the base, a unit rate.

    Parameters
    ----------
    model : pinocchio.Model
    carrier : int
        The joint that carries the point.
    beyond : float
        Distance of the point from its origin [m].

    Returns
    -------
    ndarray, shape (n,)
        For a joint that turns, the length of the chain from it to the point [m/rad]; zero for one that does
        not carry the point, and infinite where something on the way slides, since nothing bounds its travel.
    """
    reach, length = np.zeros(model.nv - 6), beyond
    for joint in reversed(list(model.supports[carrier])[2:]):
        if not model.joints[joint].shortname().startswith("JointModelR"):
            length = math.inf
        reach[model.joints[joint].idx_v - 6] = length
        length += float(np.linalg.norm(model.jointPlacements[joint].translation))
    return reach
