"""The coupling matrix in another unit of length and for another point of the base.

The singular values of C_bm mix m/rad (translation) and rad/rad (rotation), so they depend on the unit of
length, and the base's translation is that of one point. Nothing in mechanics settles either choice; the
paper's are the metre and the base's centre of mass.
"""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np

from ffsms_pin.checks import FloatArray, matrix, one_of, positive, vector

__all__ = ["Rows", "scaled"]

Rows: TypeAlias = Literal["all", "translation", "rotation"]

_ROWS = {"all": slice(0, 6), "translation": slice(0, 3), "rotation": slice(3, 6)}


def scaled(C_bm: FloatArray, characteristic_length: float, offset: FloatArray, rows: Rows) -> FloatArray:
    """Rows of the coupling matrix for another length unit and reference point.

    Parameters
    ----------
    C_bm : ndarray, shape (6, n)
        For metres and the base's centre of mass; rows [linear; angular], inertial axes.
    characteristic_length : float
        [m]. The linear rows are divided by it, which makes all of C_bm dimensionless: 1 is the paper's
        choice, 0.001 gives what millimetres give.
    offset : ndarray, shape (3,)
        From the base's centre of mass to the new reference point, inertial axes [m].
    rows : {"all", "translation", "rotation"}

    Returns
    -------
    ndarray, shape (6, n) or (3, n)

    Raises
    ------
    InvalidValue
        `characteristic_length` is not above zero, or `rows` another word.
    """
    length = positive("characteristic_length", characteristic_length, "m")
    one_of("rows", rows, _ROWS)
    moved = matrix("C_bm", C_bm, 6, None)
    offset = vector("offset", offset, 3, "m")
    # A point of the base at `offset` moves with v + omega x offset.
    moved[:3] = (moved[:3] + np.cross(moved[3:], offset, axisa=0, axisc=0)) / length
    return moved[_ROWS[rows]]
