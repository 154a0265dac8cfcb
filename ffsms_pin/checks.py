"""Checks of arguments: they return a clean value or raise `InvalidValue` with the value that is wrong."""

from __future__ import annotations

import math
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ffsms_pin.errors import InvalidValue

__all__ = ["FloatArray", "at_least_zero", "frozen", "matrix", "number", "positive", "vector"]

FloatArray: TypeAlias = NDArray[np.float64]


def _floats(name: str, value: Any) -> FloatArray:
    if isinstance(value, np.ndarray) and value.dtype == np.float64:  # the most common case
        array = np.array(value)
        if not all(map(math.isfinite, array.ravel().tolist())):
            raise InvalidValue(name, value, "must be finite")
        return array
    try:
        given = np.asarray(value)
    except (TypeError, ValueError):  # rows of different lengths
        given = np.empty(0, dtype=object)
    # Asked for floats at once, numpy would read text as numbers and drop an imaginary part.
    if given.dtype.kind not in "fiu":
        raise InvalidValue(name, value, "must hold real numbers")
    array = np.array(given, dtype=np.float64)
    if not np.isfinite(array).all():
        raise InvalidValue(name, value, "must be finite")
    return array


def vector(name: str, value: ArrayLike, size: int, unit: str = "") -> FloatArray:
    """Copy of `value` as a finite vector of `size` numbers."""
    array = _floats(name, value)
    if array.shape != (size,):
        wanted = f"must have shape ({size},)" + (f" [{unit}]" if unit else "")
        raise InvalidValue(name, value, f"{wanted} but has shape {array.shape}")
    return array


def matrix(name: str, value: ArrayLike, rows: int, columns: int) -> FloatArray:
    """Copy of `value` as a finite matrix of the given shape."""
    array = _floats(name, value)
    if array.shape != (rows, columns):
        raise InvalidValue(name, value, f"must have shape ({rows}, {columns}) but has {array.shape}")
    return array


def number(name: str, value: Any) -> float:
    """One finite number."""
    if type(value) is float and math.isfinite(value):  # the most common case, and asked in every control step
        return value
    if isinstance(value, bool):
        raise InvalidValue(name, value, "must be a number")
    array = _floats(name, value)
    if array.shape != ():
        raise InvalidValue(name, value, "must be one number")
    return float(array)


def positive(name: str, value: Any, unit: str = "") -> float:
    """One finite number above zero."""
    result = number(name, value)
    if result <= 0.0:
        raise InvalidValue(name, value, f"must be above zero{unit and f' [{unit}]'}")
    return result


def at_least_zero(name: str, value: Any, unit: str = "") -> float:
    """One finite number, not below zero."""
    result = number(name, value)
    if result < 0.0:
        raise InvalidValue(name, value, f"must be at least zero{unit and f' [{unit}]'}")
    return result


def frozen(array: FloatArray) -> FloatArray:
    """The same array, made read-only: for values that are kept and handed out."""
    array.setflags(write=False)
    return array
