"""What is built from a scenario file, in its words: values that stand once for each joint, and errors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import (
    AmbiguousEndEffector,
    FrameNotFound,
    InvalidScenario,
    InvalidUrdf,
    InvalidValue,
    ModelNotFound,
    advised,
    short,
)
from ffsms_pin.scenarios.keys import DEGREES, radians
from ffsms_pin.system import SpaceManipulator


def joint_values(
    source: Path, sms: SpaceManipulator, table: str, values: Mapping[str, Any], key: str
) -> FloatArray | None:
    """Values (n,) of a key, or of the same key in degrees; None where a table has neither.

    One number stands for all joints. `InvalidScenario`: the robot has another number of joints, or joints
    that slide are given in degrees.
    """
    used = spelt(values, key)
    if used not in values:
        return None
    array = np.asarray(values[used], dtype=np.float64)
    if array.ndim == 0:
        array = np.full(sms.n, float(array))
    if array.shape != (sms.n,):
        raise InvalidScenario(
            source,
            f"[{table}] {used} must have one value for each of the {sms.n} joints "
            f"({', '.join(sms.joint_names)}), got {array.size}",
        )
    if used == key:
        return array
    if sliding := [name for name, turns in zip(sms.joint_names, sms.layout.turns, strict=True) if not turns]:
        raise InvalidScenario(
            source,
            f"[{table}] {used} is in degrees, but {', '.join(sliding)} slides: write {key} "
            "in radians and metres",
        )
    return np.deg2rad(array)


def spelt(values: Mapping[str, Any], key: str) -> str:
    """A key as a table has it: in radians, or in degrees."""
    return key if key in values else key + DEGREES


def within_limits(source: Path, sms: SpaceManipulator, where: str, positions: FloatArray) -> FloatArray:
    """The same joint positions (n,), or `InvalidScenario` where one is outside its limits."""
    outside = sms.limits.violation(positions)
    if outside.any():
        i = int(np.argmax(outside))
        unit, factor = sms.layout.units[i]
        at, low, high = (factor * x[i] for x in (positions, sms.limits.lower, sms.limits.upper))
        raise InvalidScenario(
            source,
            f"{where} puts joint '{sms.joint_names[i]}' at {at:.6g} {unit}, outside its limits "
            f"[{low:.6g}, {high:.6g}] {unit}",
        )
    return positions


_IN_A_FILE = "[robot] {key} = {listed}"


@contextmanager
def named(source: Path, tables: Mapping[str, Any], under: str = "") -> Iterator[None]:
    """Errors of the library inside the block name the file, and the key whose value cannot be used.

    That is the key of `tables` with the name and, where there are several, the value that the error tells of;
    `under` says in which table, as "robot", if that is known.
    """
    chosen = {under: tables[under]} if under else tables
    try:
        yield
    except InvalidValue as error:
        raise InvalidScenario(source, _in_words(error, chosen, under)) from None
    except (ModelNotFound, FrameNotFound, InvalidUrdf, AmbiguousEndEffector) as error:
        if str(error).startswith(f"scenario {source}"):
            raise
        wanted = getattr(error, "frame", None) or getattr(error, "model", None)
        keys = (one for key in ("frame", "end_effector", "model") for one in _places(chosen, key))
        found = [f"{where} {key}: " for where, key, given in keys if wanted and wanted.endswith(given)]
        title = found[0] if found else f"[{under}] " if under else ""
        words = f"{title}{advised(str(error), _IN_A_FILE)}"
        if not under:
            raise InvalidScenario(source, words) from None
        error.args = (f"scenario {source}: {words}",)  # what `load` raises stays of its class
        raise


def _in_words(error: InvalidValue, tables: Mapping[str, Any], under: str) -> str:
    """What is wrong with a value, by the key of the file; by the library's name where no key has that."""
    title = f"[{under}] " if under else ""
    table, _, name = error.name.rpartition(".")
    words = advised(str(error), _IN_A_FILE)
    wrong = words.removeprefix(error.name).rpartition(", got ")[0]
    found = [one for one in _places(tables, name) if table in one[0]]
    same = [one for one in found if _holds(one, error.value)]
    if same or len(found) > 1 or not (table or under):
        found = same
    if not found and tables.get(table):
        return f"[{table}] {name}{words.removeprefix(error.name)}"
    if not found:
        return f"{title}{words}"
    where, key, given = found[0]
    if isinstance(given, Mapping) and not same:  # [attitude.dump], as a whole
        return f"[{where.strip('[]')}.{key}]{wrong}, got {short(error.value)}"
    if key.endswith(DEGREES):
        wrong = wrong.replace(" [rad]", "")
    whole = same and not isinstance(error.value, str)
    return f"{where} {key}{wrong}, got {short(given if whole else error.value)}"


def _places(tables: Mapping[str, Any], name: str, path: str = "") -> list[tuple[str, str, Any]]:
    """Table, key and value of each key of this name, or of this name in degrees."""
    found: list[tuple[str, str, Any]] = []
    for key, value in tables.items():
        inner = f"{path}.{key}" if path else key
        if path and key in (name, name + DEGREES):
            found.append((path if path.startswith("[[") else f"[{path}]", key, value))
        elif isinstance(value, Mapping):
            found += _places(value, name, inner)
        elif isinstance(value, tuple) and value and isinstance(value[0], Mapping):
            for i, row in enumerate(value, start=1):
                found += _places(row, name, f"[[{inner}]] {i}")
    return found


def _holds(place: tuple[str, str, Any], value: Any) -> bool:
    """Whether the value of a key is the one that an error tells of, or has it in it."""
    _, key, given = place
    if isinstance(value, str) and isinstance(given, tuple | Mapping):
        return value in given
    try:
        (given,) = radians({key: given}).values()
        return bool(np.array_equal(np.asarray(given), np.asarray(value)))
    except (TypeError, ValueError):
        return False
