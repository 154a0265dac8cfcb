"""How a scenario file is read: its tables and keys are known, its values usable."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from ffsms_pin.control import LAWS
from ffsms_pin.errors import InvalidScenario
from ffsms_pin.scenarios.actuated import COORDINATED_WITH
from ffsms_pin.scenarios.base_tables import STATION_KEEPING, STATIONS
from ffsms_pin.scenarios.client_tables import check_client
from ffsms_pin.scenarios.place_tables import check_places
from ffsms_pin.scenarios.tables import DEFAULT_LAW, DEGREES, HELD_BY, TABLES, Table, gains_of
from ffsms_pin.scenarios.values import Unusable, frozen, text

__all__ = ["checked_tables"]

# Terms and limits that keys of [plan] describe as well.
_SAID_TWICE = (
    ("term", "coupling", ("kappa",)),
    ("term", "effort", ("effort",)),
    ("term", "base-turn", ("base",)),
    ("limit", "clearance", ("clearance", "collision")),
    ("limit", "base", ("base_limits",)),
)

_OF_REPLANNING = {
    "dt": "the step of planning again",
    "dead_band": "of planning again",
    "jerk": "of planning again",
    "jerk" + DEGREES: "of planning again",
}


def checked_tables(source: Path, content: Mapping[str, Any]) -> dict[str, Any]:
    """Every table of a scenario, its keys known and its values usable.

    Parameters
    ----------
    source : Path
        The file, for messages.
    content : mapping
        What the TOML file holds.

    Returns
    -------
    dict
        By table: a dict of values, a tuple of those where there may be several, and where a table is left
        out, an empty one (None, if its presence means something).

    Raises
    ------
    InvalidScenario
        Names the table, the key and the value.
    """
    for name in content:
        if name not in TABLES:
            raise InvalidScenario(source, f"unknown table [{name}]; {_suggestion(name, TABLES)}")
    tables = {name: _table(source, name, table, content.get(name)) for name, table in TABLES.items()}
    _check_gains(source, tables)
    _check_alternatives(source, tables)
    _check_base(source, tables)
    check_client(source, tables)
    check_places(source, tables)
    return tables


def _table(source: Path, name: str, table: Table, given: Any) -> Any:
    """One table, or all of its kind, with the tables inside it."""
    if given is None and table.none_if_absent:
        return None
    if not table.several:
        if given is not None and not isinstance(given, dict):
            raise InvalidScenario(source, f"'{name}' must be a table: write [{name}] and its keys below it")
        return _checked(source, f"[{name}]", name, table, given or {})
    rows = [] if given is None else given
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise InvalidScenario(
            source, f"'{name}' may be there several times: write [[{name}]] and its keys below"
        )
    check = _checked if table.by_use is None else _part
    return tuple(check(source, f"[[{name}]] {i}", name, table, row) for i, row in enumerate(rows, start=1))


def _part(source: Path, title: str, name: str, table: Table, given: Mapping[str, Any]) -> dict[str, Any]:
    """A table whose keys depend on what it uses; those of a user's own class only the class knows."""
    if "use" not in given:
        raise InvalidScenario(source, f"{title} use is missing; it has no default")
    try:
        use = text(given["use"])
    except Unusable as problem:
        raise InvalidScenario(source, f"{title} use {problem}, got {_short(given['use'])}") from None
    rest = {key: value for key, value in given.items() if key != "use"}
    if ":" in use:
        return {"use": use, **{key: frozen(value) for key, value in rest.items()}}
    known = table.by_use or {}
    if use not in known:
        raise InvalidScenario(
            source,
            f"{title} use = '{use}' is no {name} of ours; {_suggestion(use, known)}; "
            "one of your own is written package.module:Class",
        )
    return {"use": use, **_checked(source, title, name, known[use], rest)}


def _checked(source: Path, title: str, name: str, table: Table, given: Mapping[str, Any]) -> dict[str, Any]:
    parsers = dict(table.keys)
    for key in table.angles:
        parsers[key + DEGREES] = parsers[key]
    values: dict[str, Any] = {}
    for key, value in given.items():
        if key in table.tables:
            values[key] = _table(source, f"{name}.{key}", table.tables[key], value)
            continue
        if key not in parsers:
            known = [*parsers, *table.tables]
            raise InvalidScenario(source, f"unknown key '{key}' in {title}; {_suggestion(key, known)}")
        try:
            values[key] = parsers[key](value)
        except Unusable as problem:
            raise InvalidScenario(source, f"{title} {key} {problem}, got {_short(value)}") from None
        if key + DEGREES in given:
            raise InvalidScenario(source, f"{title} has both {key} and {key}{DEGREES}; keep one")
    for key in table.required:
        if key not in values and key + DEGREES not in values:
            raise InvalidScenario(source, f"{title} {key} is missing; it has no default")
    return values


def _check_gains(source: Path, tables: Mapping[str, Any]) -> None:
    """Raise `InvalidScenario` for a gain that the law does not have."""
    control = tables["control"]
    law = control.get("law", DEFAULT_LAW)
    every = {gain for name in LAWS for gain in gains_of(name)}
    for key in control:
        if key in every and key not in gains_of(law):
            raise InvalidScenario(
                source,
                f'[control] {key} is no gain of the law "{law}"; its gains: {", ".join(gains_of(law))}',
            )
    if law in tables["laws"]:
        raise InvalidScenario(source, f"[laws.{law}] is the law of [control]: its gains belong there")


def _check_alternatives(source: Path, tables: Mapping[str, Any]) -> None:
    """Raise `InvalidScenario` where two keys say the same thing in different ways, or one has no effect."""
    simulation, reference = tables["simulation"], tables["reference"]
    for kind, use, keys in _SAID_TWICE:
        for i, part in enumerate(tables[kind], start=1):
            twice = [key for key in keys if key in tables["plan"]]
            if part["use"] == use and twice:
                raise InvalidScenario(
                    source, f"[plan] {twice[0]} and [[{kind}]] {i} use = '{use}' say the same; keep one"
                )
    if "v0" in simulation and "momentum" in simulation:
        raise InvalidScenario(source, "[simulation] has both v0 and momentum; keep one")
    if "q0" in simulation and {"offset", "offset" + DEGREES} & tables["control"].keys():
        raise InvalidScenario(source, "[simulation] q0 and [control] offset both move the start; keep one")
    if reference.get("kind", "plan") == "plan":
        for key, what in _OF_REPLANNING.items():
            if key in reference:
                raise InvalidScenario(source, f'[reference] {key}, {what}, needs kind = "re-planning"')
    if "end_effector" in tables["plant"] and "model" not in tables["plant"]:
        raise InvalidScenario(source, "[plant] end_effector needs a model, the plant's own")


def _check_base(source: Path, tables: Mapping[str, Any]) -> None:
    """Raise `InvalidScenario` where what acts on the base does not fit together."""
    attitude, wheels = tables["attitude"], tables["wheels"]
    mode = tables["plan"].get("mode", "floating")
    if mode in HELD_BY and attitude is None:
        raise InvalidScenario(
            source, f'[plan] mode = "{mode}" needs a table [attitude], with {HELD_BY[mode]} to hold the base'
        )
    if "wheels" in tables["robot"] and wheels is not None:
        raise InvalidScenario(source, "[robot] wheels and [wheels] both give the wheels; keep one")
    turning = wheels is not None or "wheels" in tables["robot"]
    if attitude is None:
        if "wheel_momentum" in tables["simulation"]:
            raise InvalidScenario(source, "[simulation] wheel_momentum needs a table [attitude]")
        return
    if not turning and tables["thrusters"] is None:
        raise InvalidScenario(source, "[attitude] needs [wheels] or [thrusters]")
    if attitude.get("dump") is not None and not (turning and tables["thrusters"] is not None):
        raise InvalidScenario(source, "[attitude.dump] needs [wheels] and [thrusters]")
    _check_station(source, attitude, mode, tables["thrusters"] is not None)
    joints = tables["control"].get("law", DEFAULT_LAW)
    if attitude.get("law") == "coordinated" and joints != COORDINATED_WITH:
        raise InvalidScenario(
            source, f'[attitude] law = "coordinated" needs [control] law = "{COORDINATED_WITH}"'
        )
    if "feedforward" in attitude and attitude.get("law", "quaternion") != "quaternion":
        raise InvalidScenario(source, '[attitude] feedforward is for law = "quaternion"')


def _check_station(source: Path, attitude: Mapping[str, Any], mode: str, thrusters: bool) -> None:
    """Raise `InvalidScenario` where the law that holds the base's place does not fit what else is said."""
    holds = attitude.get("holds", "both")
    if attitude.get("law") != STATION_KEEPING:
        for key in ("holds", "place"):
            if key in attitude:
                raise InvalidScenario(source, f'[attitude] {key} is for law = "{STATION_KEEPING}"')
        if mode in STATIONS:
            raise InvalidScenario(
                source,
                f'[plan] mode = "{mode}" holds the place: it needs [attitude] law = "{STATION_KEEPING}"',
            )
        return
    if not thrusters:
        raise InvalidScenario(source, f'[attitude] law = "{STATION_KEEPING}" needs [thrusters]')
    if attitude.get("dump") is not None:
        raise InvalidScenario(source, f'[attitude.dump] is not for law = "{STATION_KEEPING}"')
    if mode in STATIONS and STATIONS[mode] != holds:
        raise InvalidScenario(source, f'[plan] mode = "{mode}" needs [attitude] holds = "{STATIONS[mode]}"')


def _suggestion(word: str, allowed: Collection[str]) -> str:
    near = difflib.get_close_matches(word, allowed, n=1, cutoff=0.5)
    meant = f"did you mean '{near[0]}'? " if near else ""
    return f"{meant}(allowed: {', '.join(sorted(allowed))})"


def _short(value: Any) -> str:
    try:
        words = " ".join(repr(value).split())
    except ValueError:  # a whole number of more digits than Python writes
        words = "a very long number"
    return words if len(words) <= 80 else words[:77] + "..."
