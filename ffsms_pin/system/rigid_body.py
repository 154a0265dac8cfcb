"""Which inertias a rigid body can have, and the nearest one of those.

An inertia belongs to some rigid body where its matrix of second moments, S = tr(I) 1 / 2 - I, has no
negative eigenvalue: that says positive definite and the triangle inequality at once. A repair takes the
nearest such S.
"""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray

__all__ = ["ROUNDING", "inertia_problem", "nearest_inertia", "principal_text"]

ROUNDING = 1e-6  # relative: the last digit of a decimal in a file


def inertia_problem(tensor: FloatArray) -> str | None:
    """What keeps an inertia (3, 3) [kg m^2] from being a rigid body's: "negative", "triangle" or None."""
    a, b, c = (float(x) for x in np.linalg.eigvalsh(tensor))
    rounding = ROUNDING * max(abs(a), abs(c))
    if a < -rounding:
        return "negative"
    return "triangle" if a + b < c - rounding else None


def nearest_inertia(tensor: FloatArray, least: float) -> FloatArray:
    """The inertia (3, 3) whose second moments are nearest to the given ones and not below `least`."""
    moments = 0.5 * np.trace(tensor) * np.eye(3) - tensor
    values, axes = np.linalg.eigh(moments)
    moments = axes @ np.diag(np.maximum(values, least)) @ axes.T
    nearest = np.trace(moments) * np.eye(3) - moments
    symmetric: FloatArray = np.array(0.5 * (nearest + nearest.T), dtype=np.float64)
    return symmetric


def principal_text(tensor: FloatArray) -> str:
    """The principal inertias, ascending, for messages."""
    return ", ".join(f"{x:.6g}" for x in np.linalg.eigvalsh(tensor))
