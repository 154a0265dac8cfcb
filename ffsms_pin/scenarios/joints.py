"""What stands once for each joint: its unit for people to read, and values of a scenario's keys."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidScenario
from ffsms_pin.scenarios.keys import DEGREES
from ffsms_pin.system import SpaceManipulator


class JointUnit(NamedTuple):
    """A unit and how many of it make one radian or metre."""

    name: str
    factor: float


def joint_units(sms: SpaceManipulator) -> list[JointUnit]:
    """Unit of each joint's position."""
    return [
        JointUnit("deg", math.degrees(1.0)) if turns else JointUnit("m", 1.0) for turns in sms.layout.turns
    ]


def joint_values(
    source: Path, sms: SpaceManipulator, table: str, values: Mapping[str, Any], key: str
) -> FloatArray | None:
    """Values (n,) of a key, or of the same key in degrees; None where a table has neither.

    One number stands for all joints. `InvalidScenario`: the robot has another number of joints, or joints
    that slide are given in degrees.
    """
    used = key if key in values else key + DEGREES
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


def within_limits(
    source: Path, sms: SpaceManipulator, table: str, key: str, positions: FloatArray
) -> FloatArray:
    """The same joint positions (n,), or `InvalidScenario` where one is outside its limits."""
    outside = sms.limits.violation(positions)
    if outside.any():
        i = int(np.argmax(outside))
        unit, factor = joint_units(sms)[i]
        at, low, high = (factor * x[i] for x in (positions, sms.limits.lower, sms.limits.upper))
        raise InvalidScenario(
            source,
            f"[{table}] {key} puts joint '{sms.joint_names[i]}' at {at:.6g} {unit}, outside its limits "
            f"[{low:.6g}, {high:.6g}] {unit}",
        )
    return positions
