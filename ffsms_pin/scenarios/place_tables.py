"""Tables of a scenario file about where frames of the robot should be: target, other frames, waypoints."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ffsms_pin.errors import InvalidScenario
from ffsms_pin.scenarios.table import DEGREES, Table
from ffsms_pin.scenarios.values import Parser, not_negative, numbers, one_of, positive, text

__all__ = ["ALSO", "TARGET", "VIA", "check_places"]

_PLACE: Mapping[str, Parser] = {
    "position": numbers(3),
    "rpy": numbers(3),
    "relative_to": one_of("inertial", "base", "start"),
}

TARGET = Table(
    {
        **_PLACE,
        "velocity": numbers(3),
        "spin": numbers(3),
        "arrival_velocity": numbers(3),
        "arrival_spin": numbers(3),
        "tolerance": positive,
        "orientation_reach": positive,
    },
    frozenset({"rpy", "spin", "arrival_spin", "orientation_reach"}),
)

ALSO = Table(
    {
        "frame": text,
        **_PLACE,
        "tolerance": positive,
        "reach": positive,
        "orientation_reach": positive,
    },
    frozenset({"rpy", "orientation_reach"}),
    required=("frame", "position"),
    several=True,
)

VIA = Table(
    {
        "name": text,
        **_PLACE,
        "time": not_negative,
        "reach": positive,
        "orientation_reach": positive,
    },
    frozenset({"rpy", "orientation_reach"}),
    required=("position",),
    several=True,
)

_DURATION = 12.0  # [s] `plan`'s default
# Keys that say nothing of a place with any attitude.
_OF_ATTITUDE = ("spin", "arrival_spin", "orientation_reach")


def check_places(source: Path, tables: Mapping[str, Any]) -> None:
    """Raise `InvalidScenario` where keys of a place do not fit together, or places do not fit the plan."""
    target, plan = tables["target"], tables["plan"]
    _check_attitude(source, "[target]", target)
    moves = [key for key in ("velocity", "spin", "spin" + DEGREES) if any(target.get(key, ()))]
    arrives = [key for key in target if key.startswith("arrival_")]
    if moves and arrives:
        raise InvalidScenario(
            source,
            f"[target] {arrives[0]} is for a target that stands still: one with {moves[0]} is met with "
            "its own velocity",
        )
    turns = [key for key in arrives if key.startswith("arrival_spin")]
    if turns and "arrival_velocity" not in target:
        raise InvalidScenario(source, f"[target] {turns[0]} needs arrival_velocity too; it may be [0, 0, 0]")
    several = "also" if tables["also"] else "via" if tables["via"] else ""
    if several and plan.get("method") == "paper":
        raise InvalidScenario(
            source, f'[[{several}]] is not for [plan] method = "paper", which knows one goal and no waypoints'
        )
    frames: set[str] = set()
    for i, one in enumerate(tables["also"], start=1):
        _check_attitude(source, f"[[also]] {i}", one)
        if one["frame"] in frames:
            raise InvalidScenario(source, f"[[also]] {i} frame = '{one['frame']}' has a goal already")
        frames.add(one["frame"])
    _check_waypoints(source, tables)


def _check_waypoints(source: Path, tables: Mapping[str, Any]) -> None:
    duration = tables["plan"].get("duration", _DURATION)
    names: set[str] = set()
    for i, one in enumerate(tables["via"], start=1):
        title = f"[[via]] {i}"
        _check_attitude(source, title, one)
        if one.get("time", 0.0) > duration:
            raise InvalidScenario(
                source,
                f"{title} time = {one['time']:g} is after the deadline: [plan] duration is {duration:g}",
            )
        name = one.get("name", f"via {i}")
        if name in names:
            raise InvalidScenario(source, f"{title} name = '{name}' is there already; give it another one")
        names.add(name)
        turned = "rpy" in one or "rpy" + DEGREES in one
        if turned and "time" not in one and tables["reference"].get("kind") == "re-planning":
            raise InvalidScenario(
                source,
                f"{title} needs a time: planning again in the loop cannot see whether a pose was passed",
            )


def _check_attitude(source: Path, title: str, place: Mapping[str, Any]) -> None:
    """Raise `InvalidScenario` for keys that need an attitude where any will do."""
    if "rpy" in place or "rpy" + DEGREES in place:
        return
    for key in place:
        if key.removesuffix(DEGREES) in _OF_ATTITUDE:
            raise InvalidScenario(source, f"{title} {key} needs an attitude, rpy: without one any will do")
