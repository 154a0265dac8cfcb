"""The direction in which the end effector should move: on the cone where the paper's cost vanishes.

Directions are triples of plain numbers here: with three of them that is several times faster than arrays.
"""

from __future__ import annotations

import math
from typing import TypeAlias

__all__ = ["Triple", "cone_direction", "lateral_direction"]

Triple: TypeAlias = tuple[float, float, float]


def lateral_direction(towards: Triple, hint: Triple) -> Triple:
    """Unit vector across `towards`, as near to `hint` as possible.

    Parameters
    ----------
    towards : (float, float, float)
        Unit vector to the target.
    hint : (float, float, float)
        The side to take; where it has no part across `towards`, any side is taken.
    """
    (x, y, z), (a, b, c) = towards, hint
    along = a * x + b * y + c * z
    a, b, c = a - along * x, b - along * y, c - along * z
    size = math.sqrt(a * a + b * b + c * c)
    if size < 1e-9:
        # The cross product with the axis that is furthest from it.
        axis = min(range(3), key=lambda i: abs(towards[i]))
        a, b, c = ((0.0, z, -y), (-z, 0.0, x), (y, -x, 0.0))[axis]
        size = math.sqrt(a * a + b * b + c * c)
    return a / size, b / size, c / size


def cone_direction(towards: Triple, lateral: Triple, cosine: float) -> Triple:
    """Unit vector at the angle acos(cosine) to `towards`, on the side `lateral`."""
    (x, y, z), (a, b, c) = towards, lateral
    sine = math.sqrt(max(0.0, 1.0 - cosine * cosine))
    return cosine * x + sine * a, cosine * y + sine * b, cosine * z + sine * c
