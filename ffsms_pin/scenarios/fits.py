"""What is wrong with a scenario file in its words: tables that do not fit, and what the library refuses."""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ffsms_pin import errors
from ffsms_pin.control import LAWS
from ffsms_pin.scenarios.keys import DEGREES, radians
from ffsms_pin.scenarios.parts import HELD_BY

DEFAULT_LAW = "sliding-mode"
STATION_KEEPING = "station-keeping"  # the law that holds the base's place
COORDINATED_WITH = "computed-torque"  # the joints' law, whose gains "coordinated" takes
# What station-keeping holds in the modes of a plan that hold the base's place.
_STATIONS = {"flying": "both", "translation-flying": "place"}
# Terms and limits that keys of [plan] describe as well.
_SAID_TWICE = (
    ("term", "coupling", ("kappa",)),
    ("term", "effort", ("effort",)),
    ("term", "base-turn", ("base",)),
    ("limit", "clearance", ("clearance", "collision")),
    ("limit", "base", ("base_limits",)),
)
_OF_REPLANNING = {"dt": "the step of planning again"}
_OF_REPLANNING |= dict.fromkeys(("period", "dead_band", "jerk", "jerk" + DEGREES), "of planning again")
OF_COMPLIANCE = ("stiffness", "damping", "turn_stiffness", "turn_damping")
OF_GUIDES = ("nozzle", "ring")  # tables of [contact]
SEARCH_OPTIONS = ("effort", "base", "time_limit")  # keys of [plan] that "horizon" alone takes
# Keys that say nothing of a place with any attitude.
_OF_ATTITUDE = ("spin", "arrival_spin", "orientation_reach")
_DURATION = 12.0  # [s] `plan`'s default

_OF_LOADING = errors.ModelNotFound, errors.FrameNotFound, errors.InvalidUrdf, errors.AmbiguousEndEffector
_IN_A_FILE = "[robot] {key} = {listed}"  # advice of the library

_Tables = Mapping[str, Any]


def gains_of(law: str) -> tuple[str, ...]:
    """Names of a control law's gains."""
    others = ("sms", "dt", "torque_limit", "pose")
    return tuple(name for name in inspect.signature(LAWS[law]).parameters if name not in others)


def check_fits(source: Path, tables: _Tables) -> None:
    """Raise `InvalidScenario` where tables of a file do not fit together."""
    for check in (_gains, _method, _alternatives, _base, _task, _places):
        for problem in check(tables):
            raise errors.InvalidScenario(source, problem)


def _gains(tables: _Tables) -> Iterator[str]:
    """Gains that the law does not have."""
    law = tables["control"].get("law", DEFAULT_LAW)
    every = {gain for name in LAWS for gain in gains_of(name)}
    for key in tables["control"]:
        if key in every and key not in gains_of(law):
            yield f'[control] {key} is no gain of the law "{law}"; its gains: {", ".join(gains_of(law))}'
    if LAWS[law].needs_wrist and tables["wrist"] is None:
        yield f'[control] law = "{law}" needs a table [wrist]: it goes by what that measures; may be empty'


def _method(tables: _Tables) -> Iterator[str]:
    """Options and terms that the method does not take, unless the motion is planned again with them."""
    plan, method = tables["plan"], tables["plan"].get("method", "horizon")
    if method == "horizon":
        return
    replans = tables["reference"].get("kind") == "re-planning"
    for key in SEARCH_OPTIONS:
        if key in plan and (key == "time_limit" or not replans):
            yield f'[plan] {key} is no option of method = "{method}"; "horizon" takes it'
    if tables["term"] and method != "step" and not replans:
        yield f'[[term]] is not for [plan] method = "{method}"; "horizon" takes terms'


def _alternatives(tables: _Tables) -> Iterator[str]:
    """Two keys that say the same thing in different ways, and keys without effect."""
    simulation, reference = tables["simulation"], tables["reference"]
    for kind, use, keys in _SAID_TWICE:
        twice = [key for key in keys if key in tables["plan"]]
        for i, part in enumerate(tables[kind], start=1):
            if part["use"] == use and twice:
                yield f"[plan] {twice[0]} and [[{kind}]] {i} use = '{use}' say the same; keep one"
    if "v0" in simulation and "momentum" in simulation:
        yield "[simulation] has both v0 and momentum; keep one"
    if "q0" in simulation and _has(tables["control"], "offset"):
        yield "[simulation] q0 and [control] offset both move the start; keep one"
    if reference.get("kind", "plan") == "plan":
        for key in _OF_REPLANNING:
            if key in reference:
                yield f'[reference] {key}, {_OF_REPLANNING[key]}, needs kind = "re-planning"'
    if "end_effector" in tables["plant"] and "model" not in tables["plant"]:
        yield "[plant] end_effector needs a model, the plant's own"
    if "mount" in tables["robot"] and "wheels" in tables["robot"]:
        yield "[robot] wheels are joints of a whole robot's URDF: with [robot.mount] use [wheels]"


def _base(tables: _Tables) -> Iterator[str]:
    """What acts on the base."""
    attitude, thrusters = tables["attitude"], tables["thrusters"] is not None
    mode = tables["plan"].get("mode", "floating")
    if mode in HELD_BY and attitude is None:
        yield f'[plan] mode = "{mode}" needs a table [attitude], with {HELD_BY[mode]} to hold the base'
    if "wheels" in tables["robot"] and tables["wheels"] is not None:
        yield "[robot] wheels and [wheels] both give the wheels; keep one"
    wheels = tables["wheels"] is not None or "wheels" in tables["robot"]
    if attitude is None:
        if "wheel_momentum" in tables["simulation"]:
            yield "[simulation] wheel_momentum needs a table [attitude]"
        return
    law, holds, dumps = attitude.get("law", "quaternion"), attitude.get("holds", "both"), "dump" in attitude
    if not wheels and not thrusters:
        yield "[attitude] needs [wheels] or [thrusters]"
    if dumps and not (wheels and thrusters):
        yield "[attitude.dump] needs [wheels] and [thrusters]"
    if law == STATION_KEEPING:
        if not thrusters:
            yield f'[attitude] law = "{STATION_KEEPING}" needs [thrusters]'
        if dumps:
            yield f'[attitude.dump] is not for law = "{STATION_KEEPING}"'
        if _STATIONS.get(mode, holds) != holds:
            yield f'[plan] mode = "{mode}" needs [attitude] holds = "{_STATIONS[mode]}"'
    else:
        for key in ("holds", "place"):
            if key in attitude:
                yield f'[attitude] {key} is for law = "{STATION_KEEPING}"'
        if mode in _STATIONS:
            yield f'[plan] mode = "{mode}" holds the place: it needs [attitude] law = "{STATION_KEEPING}"'
    if law == "coordinated" and tables["control"].get("law", DEFAULT_LAW) != COORDINATED_WITH:
        yield f'[attitude] law = "coordinated" needs [control] law = "{COORDINATED_WITH}"'
    if "feedforward" in attitude and law != "quaternion":
        yield '[attitude] feedforward is for law = "quaternion"'


def _task(tables: _Tables) -> Iterator[str]:
    """Target, client, meeting and contact."""
    client, meet, contact = tables["client"], tables["meet"], tables["contact"]
    if meet is not None and client is None:
        yield "[meet] needs a table [client]: who is to be met"
    if client is not None and meet is None:
        yield "[client] needs a table [meet]; it may be empty"
    if meet is not None and "position" in tables["target"]:
        yield "[target] and [meet] both say where to go; keep one"
    if meet is None and "position" not in tables["target"]:
        yield "[target] position is missing; it has no default"
    if client is None:
        for i, one in enumerate(tables["obstacle"], start=1):
            if one.get("on") == "client":
                yield f'[[obstacle]] {i} on = "client" needs a table [client]'
        if contact:
            yield "[contact] needs a table [client]"
        return
    if tables["capture"]:
        yield "[[capture]] and [client] both give the end effector a body; keep one"
    if tables["plan"].get("method", "horizon") != "horizon":
        yield '[plan] method must be "horizon" for a client: the others meet none'
    placed = "position" in client or _has(client, "rpy")
    if _has(client, "joints") and placed:
        yield "[client] joints and position both place it; keep one"
    if not _has(client, "joints") and "position" not in client:
        yield "[client] position is missing (or joints, which meet it by construction)"
    if all(name in contact for name in OF_GUIDES):
        yield "[contact.nozzle] and [contact.ring] both say what touches the grasp; keep one"
    if "belief" in client and "sensor" not in client:
        yield "[client.belief] needs a table [client.sensor]; it may be empty"
    if contact.get("kind", "rigid") == "rigid":
        for key in (*OF_COMPLIANCE, "time"):
            if key in contact:
                yield f'[contact] {key} needs kind = "compliant"'


def _places(tables: _Tables) -> Iterator[str]:
    """Keys of a place, goals of other frames, and waypoints."""
    target = tables["target"]
    yield from _attitude("[target]", target)
    moves = [key for key in ("velocity", "spin", "spin" + DEGREES) if any(target.get(key, ()))]
    arrives = [key for key in target if key.startswith("arrival_")]
    if moves and arrives:
        yield (
            f"[target] {arrives[0]} is for a target that stands still: one with {moves[0]} is met with "
            "its own velocity"
        )
    turns = [key for key in arrives if key.startswith("arrival_spin")]
    if turns and "arrival_velocity" not in target:
        yield f"[target] {turns[0]} needs arrival_velocity too; it may be [0, 0, 0]"
    several = "also" if tables["also"] else "via"
    if tables[several] and tables["plan"].get("method") == "paper":
        yield f'[[{several}]] is not for [plan] method = "paper", which knows one goal and no waypoints'
    frames = [one["frame"] for one in tables["also"]]
    for i, one in enumerate(tables["also"]):
        yield from _attitude(f"[[also]] {i + 1}", one)
        if one["frame"] in frames[:i]:
            yield f"[[also]] {i + 1} frame = '{one['frame']}' has a goal already"
    duration = tables["plan"].get("duration", _DURATION)
    names = [one.get("name", f"via {i}") for i, one in enumerate(tables["via"], start=1)]
    for i, one in enumerate(tables["via"]):
        title = f"[[via]] {i + 1}"
        yield from _attitude(title, one)
        if one.get("time", 0.0) > duration:
            yield f"{title} time = {one['time']:g} is after the deadline: [plan] duration is {duration:g}"
        if names[i] in names[:i]:
            yield f"{title} name = '{names[i]}' is there already; give it another one"
        if _has(one, "rpy") and "time" not in one and tables["reference"].get("kind") == "re-planning":
            yield f"{title} needs a time: planning again in the loop cannot see whether a pose was passed"


def _attitude(title: str, place: _Tables) -> Iterator[str]:
    """Keys that need an attitude where any will do."""
    for key in place:
        if key.removesuffix(DEGREES) in _OF_ATTITUDE and not _has(place, "rpy"):
            yield f"{title} {key} needs an attitude, rpy: without one any will do"


def _has(table: _Tables, key: str) -> bool:
    """Whether a key is there, in radians or degrees."""
    return key in table or key + DEGREES in table


@contextmanager
def named(source: Path, tables: Mapping[str, Any], under: str = "") -> Iterator[None]:
    """Errors of the library inside the block name the file, and the key whose value cannot be used.

    That is the key of `tables` with the name and, where there are several, the value that the error tells of;
    `under` says in which table, as "robot", if that is known.
    """
    chosen = {under: tables[under]} if under else tables
    try:
        yield
    except errors.InvalidValue as error:
        raise errors.InvalidScenario(source, _in_words(error, chosen, under)) from None
    except _OF_LOADING as error:
        if str(error).startswith(f"scenario {source}"):
            raise
        wanted = getattr(error, "frame", None) or getattr(error, "model", None)
        keys = (one for key in ("frame", "end_effector", "model") for one in _found(chosen, key))
        found = [f"{where} {key}: " for where, key, given in keys if wanted and wanted.endswith(given)]
        title = found[0] if found else f"[{under}] " if under else ""
        words = f"{title}{errors.advised(str(error), _IN_A_FILE)}"
        if not under:
            raise errors.InvalidScenario(source, words) from None
        error.args = (f"scenario {source}: {words}",)  # what `load` raises stays of its class
        raise


def _in_words(error: errors.InvalidValue, tables: Mapping[str, Any], under: str) -> str:
    """What is wrong with a value, by the key of the file; by the library's name where no key has that."""
    title = f"[{under}] " if under else ""
    table, _, name = error.name.rpartition(".")
    name = name.partition("[")[0]  # an entry belongs to the key of its list
    words = errors.advised(str(error), _IN_A_FILE)
    wrong = words.removeprefix(error.name).rpartition(", got ")[0]
    found = [one for one in _found(tables, name) if table in one[0]]
    same = [one for one in found if _holds(one, error.value)]
    if same or len(found) > 1 or not (table or under):
        found = same
    if not found and tables.get(table):
        return f"[{table}] {name}{words.removeprefix(error.name)}"
    if not found:
        return f"{title}{words}"
    where, key, given = found[0]
    if isinstance(given, Mapping) and not same:  # [attitude.dump], as a whole
        return f"[{where.strip('[]')}.{key}]{wrong}, got {errors.short(error.value)}"
    if key.endswith(DEGREES):
        wrong = wrong.replace(" [rad]", "")
    whole = same and not isinstance(error.value, str)
    return f"{where} {key}{wrong}, got {errors.short(given if whole else error.value)}"


def _found(tables: Mapping[str, Any], name: str, path: str = "") -> list[tuple[str, str, Any]]:
    """Table, key and value of each key of this name, or of this name in degrees."""
    found: list[tuple[str, str, Any]] = []
    for key, value in tables.items():
        inner = f"{path}.{key}" if path else key
        if path and key in (name, name + DEGREES):
            found.append((path if path.startswith("[[") else f"[{path}]", key, value))
        elif isinstance(value, Mapping):
            found += _found(value, name, inner)
        elif isinstance(value, tuple) and value and isinstance(value[0], Mapping):
            for i, row in enumerate(value, start=1):
                found += _found(row, name, f"[[{inner}]] {i}")
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
