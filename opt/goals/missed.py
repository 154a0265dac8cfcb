"""What a frame misses of a place, with slopes: rows for the way, and for the turn as far as it counts."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.system.batch.stacks import apply, cross, dot, skew

__all__ = ["Missed", "excess", "shortened"]

_TINY = 1e-12
# [rad] Slopes of rotation vectors are taken at an angle between these: they have no limit at half a turn.
_LEAST_ANGLE, _MOST_ANGLE = 1e-4, np.pi - 1e-3


class Missed(NamedTuple):
    """What frames miss of a place, in the axes that the place is given in.

    Attributes
    ----------
    way : ndarray, shape (3, ...)
        From the frame to the place [m].
    vector : ndarray, shape (3, ...)
        Rotation vector that takes the frame's attitude to the nearest that will do [rad].
    rows : ndarray, shape (r, 3, ...)
        Directions, a unit vector each, in which the attitude counts: none, two or three.
    axis : ndarray, shape (3, ...), or None
        Where the axis should point about which the frame may be turned, where there is one.
    """

    way: FloatArray
    vector: FloatArray
    rows: FloatArray
    axis: FloatArray | None = None

    @property
    def turn(self) -> FloatArray:
        """Components (r, ...) of the rotation vector along the rows [rad]."""
        return self.along(self.vector)

    def along(self, turns: FloatArray) -> FloatArray:
        """Components (r, ...) along the rows, of rotation vectors (3, ...) or of columns (3, n, ...)."""
        if self.axis is None:  # all or none
            return turns[: len(self.rows)]
        return apply(self.rows, turns)

    @property
    def distance(self) -> FloatArray:
        """Length of the way (...) [m]."""
        return np.sqrt(dot(self.way, self.way))

    @property
    def angle(self) -> FloatArray:
        """Length of the rotation vector (...) [rad]; zero where any attitude will do."""
        return np.sqrt(dot(self.vector, self.vector))

    def take(self, *index: Any) -> Missed:
        """That of the frames at an index."""
        axis = None if self.axis is None else self.axis[(..., *index)]
        rows = np.broadcast_to(self.rows, (*self.rows.shape[:2], *self.way.shape[1:]))
        return Missed(self.way[(..., *index)], self.vector[(..., *index)], rows[(..., *index)], axis)

    def words(self, *index: int) -> str:
        """What the frame at an index misses: a distance, and an angle where the attitude counts."""
        angle = f", turned by {np.degrees(self.angle[index]):.2f} deg," if len(self.rows) else ""
        return f"{1e3 * self.distance[index]:.1f} mm{angle}"

    def by_turn(self) -> FloatArray:
        """Slopes (r, 3, ...) of `turn` by a turn of the frame."""
        if not len(self.rows):
            return self.rows
        e, safe = self.vector, np.clip(self.angle, _LEAST_ANGLE, _MOST_ANGLE)
        sine, cosine = np.sin(safe), np.cos(safe)
        eye = np.eye(3).reshape(3, 3, *(1,) * safe.ndim)
        if self.axis is None:
            # d log(X exp(-delta)) = -J_r^-1(e) delta. Reference: J. Sola et al., "A micro Lie theory", 2018,
            # eq. 144.
            factor = 1.0 / safe**2 - (1.0 + cosine) / (2.0 * safe * sine)
            E = skew(e)
            return -(eye + 0.5 * E + factor * apply(E, E))
        # e = angle / sine (u x t) for the frame's axis u and the wanted one t; a turn phi moves u by phi x u.
        sideways = e * (sine / safe)
        u = cosine * self.axis + cross(self.axis, sideways)
        by_cosine = -(sine - safe * cosine) / sine**3
        slope = (safe / sine) * (u[:, None] * self.axis - cosine * eye)
        return apply(self.rows, slope + by_cosine * (sideways[:, None] * sideways))


def shortened(e: FloatArray, slope: FloatArray | None, allowed: float) -> tuple[FloatArray, FloatArray]:
    """Vectors (r, ...) less an allowed length, and their slopes, where those of `e` are (r, 3, ...).

    None: minus one, those of a way by the position of the frame.
    """
    short, unit, along, across = _parts(e, allowed)
    matrix = across + along * (unit[:, None] * unit)
    return short * unit, -matrix if slope is None else apply(matrix, slope)


def excess(e: FloatArray, slope: FloatArray | None, allowed: float) -> tuple[FloatArray, FloatArray]:
    """By how much vectors (r, ...) are longer than allowed: values (1 + r, ...), slopes (1 + r, 3, ...).

    The first is the excess. The others are zero, with slopes across the vector, for the second derivatives:
    the squares of all have the same slopes, and the same second derivatives by Gauss and Newton, as those of
    the components of the shortened vector.
    """
    short, unit, along, across = _parts(e, allowed)
    matrix = np.concatenate([(along * unit)[None], across])
    return np.concatenate([short[None], np.zeros_like(e)]), -matrix if slope is None else apply(matrix, slope)


def _parts(e: FloatArray, allowed: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Of vectors: the length beyond what is allowed, the direction, and slopes of that along and across."""
    length = np.sqrt(dot(e, e))
    short, unit = np.maximum(length - allowed, 0.0), e / np.maximum(length, _TINY)
    eye = np.eye(len(e)).reshape(len(e), len(e), *(1,) * length.ndim)
    across = short / np.maximum(length, _TINY) * (eye - unit[:, None] * unit)
    return short, unit, np.where(short > 0.0, 1.0, 0.0), across
