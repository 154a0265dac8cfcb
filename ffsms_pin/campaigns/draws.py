"""Random values for keys of a scenario file, from the distributions in [campaign.draw]."""

from __future__ import annotations

import copy
import json
import zlib
from collections.abc import Iterator, Mapping
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np

from ffsms_pin.errors import InvalidScenario
from ffsms_pin.options.tables import DEGREES

# Keys of random seeds; each run sets the keys whose tables the scenario has.
_SEEDS = ("sensors.seed", "wrist.seed", "plant.random.seed", "client.sensor.seed")
_KINDS = ("uniform", "normal", "choice")
_ADVICE = "write { uniform = [low, high] }, { normal = [mean, deviation] } or { choice = [value, value] }"


def flat_draws(table: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield each drawn key, such as "plant.arm_mass", and its distribution from nested tables."""
    for name, value in table.items():
        if isinstance(value, Mapping) and value and not set(value) & set(_KINDS):
            yield from flat_draws(value, f"{path}{name}.")
        else:
            yield path + name, value


def drawn_columns(draws: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """Return a seed's drawn values as columns by name.

    An array from a uniform or normal distribution has a column for each entry, numbered from 0. A choice that
    is neither text nor number is written as JSON.
    """
    columns: dict[str, Any] = {}
    for key, distribution in draws.items():
        value = _draw(distribution, _stream(key, seed))
        if isinstance(value, list) and "choice" not in distribution:
            columns |= {f"draw.{key}.{i}": entry for i, entry in enumerate(value)}
        else:
            plain = isinstance(value, (str, int, float)) and not isinstance(value, bool)
            columns[f"draw.{key}"] = value if plain else json.dumps(value)
    return columns


def drawn_content(
    source: Path, content: Mapping[str, Any], draws: Mapping[str, Any], seed: int
) -> dict[str, Any]:
    """Return the content of a scenario file with the drawn values of a seed.

    Raises
    ------
    InvalidScenario
        A key cannot be set in the tables of the file, or a distribution is invalid.
    """
    tables = copy.deepcopy(dict(content))
    for key in _SEEDS:
        *path, name = key.split(".")
        table = reduce(lambda outer, inner: outer.get(inner, {}), path, tables)
        table[name] = int(_stream(key, seed).integers(2**31))
    for key, distribution in draws.items():
        try:
            value = _draw(distribution, _stream(key, seed))
        except (OverflowError, TypeError, ValueError) as error:
            message = f"[campaign.draw] {key} = {distribution} cannot be drawn ({error}); {_ADVICE}"
            raise InvalidScenario(source, message) from None
        try:
            _set(tables, key, copy.deepcopy(value))
        except (AttributeError, LookupError, TypeError, ValueError):
            message = (
                f"[campaign.draw] {key} is no key of the file; write it like plant.arm_mass or fault.1.time"
            )
            raise InvalidScenario(source, message) from None
    for name in ("fault", "capture", "disturbance"):  # drop entries for which {} was drawn
        if isinstance(tables.get(name), list):
            tables[name] = [row for row in tables[name] if row != {}]
    return tables


def _stream(key: str, seed: int) -> np.random.Generator:
    """Return the random generator of a key and a seed; it does not depend on other draws in the file."""
    return np.random.default_rng([seed, zlib.crc32(key.encode())])


def _draw(distribution: Any, rng: np.random.Generator) -> Any:
    """Draw a number, a list of numbers or a choice; raise `ValueError` if the distribution is invalid."""
    if (
        not isinstance(distribution, Mapping)
        or len(distribution) != 1
        or not set(distribution) <= set(_KINDS)
    ):
        raise ValueError(f"it must be a table with one of {', '.join(_KINDS)}")
    ((kind, values),) = distribution.items()
    if kind == "choice":
        if not isinstance(values, list | tuple) or not values:
            raise ValueError("choice must be a list of one or more values")
        return values[int(rng.integers(len(values)))]
    if not isinstance(values, list | tuple) or len(values) != 2:
        raise ValueError(f"{kind} must be a list of two values")
    first, second = values
    sample: Any = {"uniform": rng.uniform, "normal": rng.normal}[kind]
    return np.asarray(sample(first, second)).tolist()


def _set(table: Any, key: str, value: Any) -> None:
    """Set a key of nested tables, such as "fault.1.time"; list indices in the key begin at 1."""
    *path, last = key.split(".")
    for name in path:
        table = (
            dict(enumerate(table, 1))[int(name)] if isinstance(table, list) else table.setdefault(name, {})
        )
    if isinstance(table, list):
        table[range(len(table)).index(int(last) - 1)] = value
    else:  # the drawn value also replaces a value in the other unit (rad or deg)
        table.pop(last.removesuffix(DEGREES) if last.endswith(DEGREES) else last + DEGREES, None)
        table[last] = value
