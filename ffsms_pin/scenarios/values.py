"""What a value in a scenario file may be: each parser returns it clean, or says what is wrong with it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeAlias

from ffsms_pin.checks import LARGEST, SMALLEST_POSITIVE

__all__ = [
    "Parser",
    "Unusable",
    "either",
    "flag",
    "frozen",
    "gain",
    "matrix",
    "named_numbers",
    "not_negative",
    "number",
    "numbers",
    "one_of",
    "or_infinite",
    "per_joint",
    "positive",
    "table",
    "text",
    "texts",
    "whole",
]

Parser: TypeAlias = Callable[[Any], Any]


class Unusable(Exception):
    """A value is not what its key asks for."""


def number(value: Any) -> float:
    """A finite number, no larger than 1e9."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise Unusable("must be a number")
    try:
        result = float(value)
    except OverflowError:
        raise Unusable("is too large") from None
    if not math.isfinite(result):
        raise Unusable("must be finite")
    if abs(result) > LARGEST:
        raise Unusable(f"must lie within {-LARGEST:g} and {LARGEST:g}")
    return result


def positive(value: Any) -> float:
    """A finite number above zero, from 1e-12 to 1e9."""
    result = number(value)
    if result <= 0.0:
        raise Unusable("must be above zero")
    if result < SMALLEST_POSITIVE:
        raise Unusable(f"must be at least {SMALLEST_POSITIVE:g}")
    return result


def not_negative(value: Any) -> float:
    """A finite number of at least zero."""
    result = number(value)
    if result < 0.0:
        raise Unusable("must not be negative")
    return result


def or_infinite(entry: Parser) -> Parser:
    """What `entry` takes, or `inf`."""
    return lambda value: math.inf if isinstance(value, float) and value == math.inf else entry(value)


def whole(least: int) -> Parser:
    """A whole number of at least `least`."""

    def parse(value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            raise Unusable(f"must be a whole number of at least {least}")
        return value

    return parse


def flag(value: Any) -> bool:
    """True or false."""
    if not isinstance(value, bool):
        raise Unusable("must be true or false")
    return value


def text(value: Any) -> str:
    """A text that is not empty."""
    if not isinstance(value, str) or not value.strip() or "\0" in value:
        raise Unusable("must be a text that is not empty")
    return value


def texts(value: Any) -> tuple[str, ...]:
    """A list of texts, each of them not empty."""
    if not isinstance(value, list):
        raise Unusable("must be a list of texts")
    return tuple(text(item) for item in value)


def named_numbers(value: Any) -> dict[str, float]:
    """A table of numbers by name."""
    if not isinstance(value, dict) or not value:
        raise Unusable("must be a table of numbers by joint, as {joint_2 = 0.5}")
    return {key: number(item) for key, item in value.items()}


def table(value: Any) -> dict[str, Any]:
    """Any table."""
    if not isinstance(value, dict):
        raise Unusable("must be a table")
    return {key: frozen(item) for key, item in value.items()}


def frozen(value: Any) -> Any:
    """Any value, its lists as tuples."""
    if isinstance(value, list):
        return tuple(frozen(item) for item in value)
    return {key: frozen(item) for key, item in value.items()} if isinstance(value, dict) else value


def one_of(*choices: str) -> Parser:
    """One of a few texts."""

    def parse(value: Any) -> str:
        if value not in choices:
            raise Unusable("must be one of " + ", ".join(f'"{choice}"' for choice in choices))
        return str(value)

    return parse


def numbers(size: int | None = None, entry: Parser = number) -> Parser:
    """A list of `size` numbers, or of any number of them."""

    def parse(value: Any) -> tuple[float, ...]:
        if not isinstance(value, list) or not value or (size is not None and len(value) != size):
            raise Unusable(f"must be a list of {size or 'one or more'} numbers")
        return tuple(entry(item) for item in value)

    return parse


def matrix(rows: int | None, columns: int) -> Parser:
    """A list of `rows` (or any number of) lists of `columns` numbers."""

    def parse(value: Any) -> tuple[tuple[float, ...], ...]:
        if not isinstance(value, list) or not value or (rows is not None and len(value) != rows):
            raise Unusable(f"must be a list of {rows or 'one or more'} lists of {columns} numbers")
        return tuple(numbers(columns)(row) for row in value)

    return parse


def either(flat: Parser, nested: Parser) -> Parser:
    """A list of numbers, or a list of lists."""

    def parse(value: Any) -> Any:
        rows = isinstance(value, list) and bool(value) and all(isinstance(row, list) for row in value)
        return nested(value) if rows else flat(value)

    return parse


def per_joint(entry: Parser = number) -> Parser:
    """One number for all joints, or a list with one each; how many those are, only the robot knows."""
    return lambda value: numbers(None, entry)(value) if isinstance(value, list) else entry(value)


def gain(value: Any) -> Any:
    """One number, one a joint, or a square matrix."""
    return either(per_joint(), lambda rows: matrix(len(rows), len(rows))(rows))(value)
