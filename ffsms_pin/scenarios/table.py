"""What may stand in a table of a scenario file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ffsms_pin.scenarios.values import Parser

__all__ = ["DEGREES", "Table", "radians"]

DEGREES = "_deg"  # ending of the keys that give an angle in degrees


@dataclass(frozen=True)
class Table:
    """What may stand in a table.

    Attributes
    ----------
    keys : mapping of str to parser
    angles : frozenset of str
        Keys that may be given in degrees as well, under their name with `_deg`.
    required : tuple of str
        Keys without a default.
    tables : mapping of str to Table
        Tables inside it.
    several : bool
        Whether it is an array of tables, [[name]].
    none_if_absent : bool
        Whether a table without keys is another thing than no table.
    by_use : mapping of str to Table, or None
        What may stand beside the key `use`, by its value; beside an import path anything may.
    """

    keys: Mapping[str, Parser]
    angles: frozenset[str] = frozenset()
    required: tuple[str, ...] = ()
    tables: Mapping[str, Table] = field(default_factory=dict)
    several: bool = False
    none_if_absent: bool = False
    by_use: Mapping[str, Table] | None = None


def radians(values: Mapping[str, Any]) -> dict[str, Any]:
    """The same values with those in degrees in radians, under their names without `_deg`."""
    return {
        key.removesuffix(DEGREES): _radians(value) if key.endswith(DEGREES) else value
        for key, value in values.items()
    }


def _radians(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: math.radians(one) for name, one in value.items()}
    return tuple(map(math.radians, value)) if isinstance(value, tuple) else math.radians(value)
