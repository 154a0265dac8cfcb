"""Whether the arrays of a result file fit together."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.errors import ResultError

__all__ = ["check_shapes", "check_times", "numbers_by_name"]

NUMBERS, TRUTH, TEXT = "fiu", "b", "U"
_KINDS = {NUMBERS: "no numbers", TRUTH: "no yes or no", TEXT: "no text"}


def check_shapes(
    path: str | os.PathLike[str],
    arrays: Mapping[str, Any],
    wanted: Mapping[str, tuple[str | int, ...]],
    others: Mapping[str, str] | None = None,
) -> None:
    """Raise `ResultError` unless arrays hold what they should, in shapes that fit together.

    `arrays` are anything with `shape` and `dtype`, as headers. `wanted` has the dimensions of each: numbers,
    or sizes by name ("N", "n", "nq") with or without a number added ("N+1"); the first array that has a size
    sets it. Where "n" joints and "nq" are named, nq is checked against n: a free base has 7 of them, and a
    joint 1 or, where it turns for ever, 2. `others` has the kinds of data (numpy's letters) of arrays that
    hold no numbers.
    """
    sizes: dict[str, int] = {}
    for name, dimensions in wanted.items():
        array, kind = arrays[name], (others or {}).get(name, NUMBERS)
        if array.dtype.kind not in kind:
            raise ResultError(path, f"holds {_KINDS[kind]} in {name}")
        if len(array.shape) == len(dimensions):
            for size, dimension in zip(array.shape, dimensions, strict=True):
                if isinstance(dimension, str):
                    word, _, added = dimension.partition("+")
                    sizes.setdefault(word, size - int(added or 0))
        expected = tuple(_size(dimension, sizes) for dimension in dimensions)
        if array.shape != expected:
            fit = ", ".join("any" if size is None else "more" if size < 0 else str(size) for size in expected)
            comma = "," if len(expected) == 1 else ""
            raise ResultError(path, f"holds {name} of shape {array.shape} where ({fit}{comma}) would fit")
    n, nq = sizes.get("n"), sizes.get("nq")
    if n is not None and nq is not None and not 7 + n <= nq <= 7 + 2 * n:
        raise ResultError(
            path, f"holds q of shape {arrays['q'].shape} where {7 + n} to {7 + 2 * n} columns would fit"
        )


def check_times(path: str | os.PathLike[str], t: NDArray[np.float64], least: int = 1) -> None:
    """Raise `ResultError` unless there are so many instants, finite and rising."""
    if len(t) < least:
        raise ResultError(path, f"holds {len(t)} instants in t where at least {least} are needed")
    if not (np.isfinite(t).all() and (np.diff(t) > 0.0).all()):
        raise ResultError(path, "holds instants in t that do not rise")


def numbers_by_name(path: str | os.PathLike[str], name: str, text: str, rows: bool = False) -> dict[str, Any]:
    """Numbers, or rows of numbers as arrays, that a result keeps by name in a text of JSON."""
    try:
        found = json.loads(text)
        if rows:
            return {key: np.array([_number(one) for one in row]) for key, row in found.items()}
        return {key: _number(value) for key, value in found.items()}
    except (ValueError, TypeError, AttributeError, OverflowError, RecursionError):
        raise ResultError(path, f"holds no numbers by name in {name}") from None


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError("no number")
    return float(value)


def _size(dimension: str | int, sizes: Mapping[str, int]) -> int | None:
    """A dimension in numbers; None where no array has set it yet."""
    if isinstance(dimension, int):
        return dimension
    word, _, added = dimension.partition("+")
    if word not in sizes:
        return None
    # A negative size fits no array.
    return sizes[word] + int(added or 0) if sizes[word] >= 0 else -1
