"""The direction in which the end effector should move: on the cone where the paper's cost vanishes."""

from __future__ import annotations

import math

import numpy as np

from ffsms_pin.checks import FloatArray

__all__ = ["cone_direction", "lateral_direction"]


def lateral_direction(towards: FloatArray, hint: FloatArray) -> FloatArray:
    """Unit vector across `towards`, as near to `hint` as possible.

    Parameters
    ----------
    towards : ndarray, shape (3,)
        Unit vector to the target.
    hint : ndarray, shape (3,)
        The side to take; where it has no part across `towards`, any side is taken.
    """
    across = hint - (hint @ towards) * towards
    size = math.sqrt(float(across @ across))
    if size < 1e-9:
        spare = np.zeros(3)
        spare[int(np.argmin(np.abs(towards)))] = 1.0
        across = np.cross(towards, spare)
        size = math.sqrt(float(across @ across))
    return across / size


def cone_direction(towards: FloatArray, lateral: FloatArray, cosine: float) -> FloatArray:
    """Unit vector at the angle acos(cosine) to `towards`, on the side `lateral`; all of shape (3,)."""
    return cosine * towards + math.sqrt(max(0.0, 1.0 - cosine * cosine)) * lateral
