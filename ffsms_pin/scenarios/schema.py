"""What a scenario file may hold: its tables, their keys, and what each value must be."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

from ffsms_pin.errors import InvalidScenario
from ffsms_pin.opt import METHODS

__all__ = ["DEGREES", "checked_tables"]

DEGREES = "_deg"  # ending of the keys that give an angle in degrees


class _Unusable(Exception):
    """A value is not what its key asks for."""


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise _Unusable("must be a number")
    try:
        result = float(value)
    except OverflowError:
        raise _Unusable("is too large") from None
    if not math.isfinite(result):
        raise _Unusable("must be finite")
    return result


def _positive(value: Any) -> float:
    result = _number(value)
    if result <= 0.0:
        raise _Unusable("must be above zero")
    return result


def _not_negative(value: Any) -> float:
    result = _number(value)
    if result < 0.0:
        raise _Unusable("must not be negative")
    return result


def _text(value: Any) -> str:
    if not isinstance(value, str) or not value.strip() or "\0" in value:
        raise _Unusable("must be a text that is not empty")
    return value


def _one_of(*choices: str) -> Callable[[Any], str]:
    def parse(value: Any) -> str:
        if value not in choices:
            raise _Unusable("must be one of " + ", ".join(f'"{choice}"' for choice in choices))
        return str(value)

    return parse


def _numbers(size: int | None = None, entry: Callable[[Any], float] = _number) -> Callable[[Any], Any]:
    def parse(value: Any) -> tuple[float, ...]:
        if not isinstance(value, list) or not value or (size is not None and len(value) != size):
            raise _Unusable(f"must be a list of {size or 'one or more'} numbers")
        return tuple(entry(item) for item in value)

    return parse


def _per_joint(entry: Callable[[Any], float] = _number) -> Callable[[Any], Any]:
    """One number for all joints, or a list with one each; how many those are, only the robot knows."""
    return lambda value: _numbers(None, entry)(value) if isinstance(value, list) else entry(value)


def _gain(value: Any) -> Any:
    """One number, one a joint, or a matrix."""
    if isinstance(value, list) and value and all(isinstance(row, list) for row in value):
        return tuple(_numbers(len(value))(row) for row in value)
    return _per_joint()(value)


_TABLES: dict[str, dict[str, Callable[[Any], Any]]] = {
    "robot": {"model": _text, "end_effector": _text, "base_size": _numbers(3, _positive)},
    "start": {"joints": _numbers()},
    "target": {"position": _numbers(3)},
    "plan": {
        "duration": _positive,
        "dt": _positive,
        "kappa": _positive,
        "clearance": _not_negative,
        "collision": _one_of("points", "shapes", "off"),
        "method": _one_of(*METHODS),
        "reach": _positive,
    },
    "limits": {
        "lower": _per_joint(),
        "upper": _per_joint(),
        "velocity": _per_joint(_positive),
        "acceleration": _per_joint(_positive),
        "torque": _per_joint(_positive),
    },
    "control": {
        "K_s": _gain,
        "Gamma": _gain,
        "boundary": _per_joint(_positive),
        "torque_limit": _per_joint(_positive),
        "dt": _positive,
        "offset": _per_joint(),
    },
}
_ANGLES = {
    "start": {"joints"},
    "limits": {"lower", "upper", "velocity", "acceleration"},
    "control": {"offset"},
}
_REQUIRED = {"robot": "model", "start": "joints", "target": "position"}


def checked_tables(source: Path, content: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Every table of a scenario, its keys known and its values usable; tables that are left out are empty.

    Parameters
    ----------
    source : Path
        The file, for messages.
    content : mapping
        What the TOML file holds.

    Raises
    ------
    InvalidScenario
        Names the table, the key and the value.
    """
    for table in content:
        if table not in _TABLES:
            raise InvalidScenario(source, f"unknown table [{table}]; {_suggestion(table, _TABLES)}")
    return {table: _checked(source, table, content.get(table, {})) for table in _TABLES}


def _checked(source: Path, table: str, given: Any) -> dict[str, Any]:
    if not isinstance(given, dict):
        raise InvalidScenario(source, f"'{table}' must be a table: write [{table}] and its keys below it")
    parsers = dict(_TABLES[table])
    for key in _ANGLES.get(table, ()):
        parsers[key + DEGREES] = parsers[key]
    values = {}
    for key, value in given.items():
        if key not in parsers:
            raise InvalidScenario(source, f"unknown key '{key}' in [{table}]; {_suggestion(key, parsers)}")
        try:
            values[key] = parsers[key](value)
        except _Unusable as problem:
            raise InvalidScenario(source, f"[{table}] {key} {problem}, got {_short(value)}") from None
        if key + DEGREES in given:
            raise InvalidScenario(source, f"[{table}] has both {key} and {key}{DEGREES}; keep one")
    required = _REQUIRED.get(table)
    if required is not None and required not in values and required + DEGREES not in values:
        raise InvalidScenario(source, f"[{table}] {required} is missing; it has no default")
    return values


def _suggestion(word: str, allowed: Collection[str]) -> str:
    near = difflib.get_close_matches(word, allowed, n=1, cutoff=0.5)
    meant = f"did you mean '{near[0]}'? " if near else ""
    return f"{meant}(allowed: {', '.join(sorted(allowed))})"


def _short(value: Any) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 80 else text[:77] + "..."
