"""Checks of what actuators are given: rows of three numbers, and numbers one an actuator."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, dimensions, frozen, matrix
from ffsms_pin.errors import InvalidValue


def rows(name: str, value: ArrayLike, count: int | None = None) -> FloatArray:
    """A read-only array (count, 3); one row may be given without the second pair of brackets."""
    given = dimensions(name, value)
    table: Any = [value] if given == 1 else value if isinstance(value, Sequence) else np.asarray(value)
    length = len(table) if given else 0
    if length == 0:
        raise InvalidValue(name, value, "must be a list of rows of three numbers")
    array = matrix(name, table, length, 3)
    if count is not None and length != count:
        raise InvalidValue(name, value, f"must have {count} rows but has {length}")
    return frozen(array)


def directions(name: str, value: ArrayLike, count: int | None = None) -> FloatArray:
    """Unit vectors (count, 3), from vectors of any length but zero."""
    array = rows(name, value, count)
    lengths = np.linalg.norm(array, axis=1, keepdims=True)
    if not (lengths > 1e-9).all():
        raise InvalidValue(name, value, "must not hold a vector of length zero")
    return frozen(array / lengths)


def one_each(
    name: str,
    value: ArrayLike,
    count: int,
    unit: str = "",
    *,
    zero: bool = False,
    infinite: bool = False,
) -> FloatArray:
    """Numbers (count,), from one or `count`: above zero, or with `zero` at least zero."""
    dimensions(name, value)
    given = np.asarray(value)
    if given.dtype.kind not in "fiu" or given.shape not in ((), (count,)):
        raise InvalidValue(name, value, f"must be one number or ({count},){unit and f' [{unit}]'}")
    numbers = np.full(count, given, dtype=np.float64)
    low = (numbers >= 0.0) if zero else (numbers >= 1e-12)
    high = numbers <= (math.inf if infinite else 1e9)
    if not (low & high).all():  # also NaN
        least = "at least zero" if zero else "above zero"
        raise InvalidValue(name, value, f"must be {least}{unit and f' [{unit}]'}, and no larger than 1e9")
    return frozen(numbers)
