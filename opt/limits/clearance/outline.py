"""Points of a convex shape, whose hull shows it: for figures and the viewer."""

from __future__ import annotations

import itertools
from typing import Any

import coal
import numpy as np

from ffsms_pin.checks import FloatArray

__all__ = ["outline"]

_ROUND = 32  # points around a circle
_BANDS = 15  # circles on a ball


def outline(shape: Any) -> FloatArray:
    """Points (k, 3) of a shape, in its own axes [m]; its corners, or close enough on what is round."""
    if isinstance(shape, coal.Box):
        signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
        return np.asarray(signs * shape.halfSide)
    if isinstance(shape, coal.Sphere):
        return float(shape.radius) * _ball()
    if isinstance(shape, coal.Ellipsoid):
        return np.asarray(_ball() * shape.radii)
    if isinstance(shape, coal.Capsule | coal.Cylinder | coal.Cone):
        up = np.array([0.0, 0.0, shape.halfLength])
        if isinstance(shape, coal.Capsule):
            ball = float(shape.radius) * _ball()
            return np.concatenate([ball + up, ball - up])
        ring = shape.radius * _ring()
        return np.concatenate([up[None] if isinstance(shape, coal.Cone) else ring + up, ring - up])
    return np.array(shape.points(), dtype=np.float64)


def _ring() -> FloatArray:
    angle = np.linspace(0.0, 2.0 * np.pi, _ROUND, endpoint=False)
    return np.column_stack([np.cos(angle), np.sin(angle), np.zeros(_ROUND)])


def _ball() -> FloatArray:
    latitudes = np.linspace(-0.5 * np.pi, 0.5 * np.pi, _BANDS)
    return np.concatenate([np.cos(at) * _ring() + [0.0, 0.0, np.sin(at)] for at in latitudes])
