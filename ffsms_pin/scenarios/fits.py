"""Errors of scenario files in the file's words: tables that do not fit, and values out of range."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ffsms_pin import errors
from ffsms_pin.control import LAWS
from ffsms_pin.opt import Problem
from ffsms_pin.scenarios.keys import DEGREES, options_of
from ffsms_pin.scenarios.paths import CURVES
from ffsms_pin.scenarios.tables import (
    BASE_LAWS,
    DEFAULT_LAW,
    NONE_IF_ABSENT,
    STATION_KEEPING,
    is_table,
)

# Modes of a plan that a closed loop can follow, and what then holds the attitude.
HELD_BY: Mapping[str, str] = {
    "rotation-floating": "wheels",
    "rotation-flying": "thrusters",
    "translation-flying": "thrusters",
    "flying": "thrusters",
}


COORDINATED_WITH = "computed-torque"  # the joints' law, whose gains "coordinated" takes
# Defaults of keys that choose.
_DEFAULTS = {
    "plan.method": "horizon",
    "control.law": DEFAULT_LAW,
    "attitude.law": "quaternion",
    "attitude.holds": "both",
}
# Terms and limits that keys of [plan] set as well.
_SET_TWICE = (
    ("term", "coupling", ("kappa",)),
    ("term", "effort", ("effort",)),
    ("term", "base-turn", ("base",)),
    ("limit", "clearance", ("clearance", "collision")),
    ("limit", "base", ("base_limits",)),
)
OF_HORIZON = ("effort", "base", "time_limit")  # keys of [plan] that this method alone takes
# Keys that say nothing of a place with any attitude.
_OF_ATTITUDE = ("spin", "arrival_spin", "orientation_reach")

_OF_LOADING = errors.ModelNotFound, errors.FrameNotFound, errors.InvalidUrdf, errors.AmbiguousEndEffector
_IN_A_FILE = "[robot] {key} = {listed}"  # advice of the library

_Tables = Mapping[str, Any]


# What each method, kind, law and shape takes: table, the key that chooses, its default, and keys by choice.
# All other keys of a table are for every choice.
TAKES: tuple[tuple[str, str, str, Mapping[str, tuple[str, ...]]], ...] = (
    ("plan", "method", "horizon", {"horizon": OF_HORIZON}),
    ("reference", "kind", "plan", {"re-planning": ("dt", "period", "dead_band", "jerk")}),
    (
        "contact",
        "kind",
        "rigid",
        {"compliant": ("stiffness", "damping", "turn_stiffness", "turn_damping", "time")},
    ),
    (
        "attitude",
        "law",
        "quaternion",
        {
            "quaternion": (*options_of(BASE_LAWS["quaternion"]), "dump"),
            "coordinated": (*options_of(BASE_LAWS["coordinated"]), "dump"),
            STATION_KEEPING: tuple(options_of(BASE_LAWS[STATION_KEEPING])),
        },
    ),
    ("control", "law", DEFAULT_LAW, {law: tuple(options_of(made)) for law, made in LAWS.items()}),
    ("path", "curve", "", {curve: (*needed, *others) for curve, (needed, others) in CURVES.items()}),
    (
        "obstacle",
        "shape",
        "",
        {
            "box": ("size",),
            "sphere": ("radius",),
            "cylinder": ("radius", "length"),
            "capsule": ("radius", "length"),
            "mesh": ("file", "scale"),
        },
    ),
)
# Conditions are tables, keys or values of keys, as "attitude", "attitude.dump", "attitude.law = coordinated".
# A condition that needs one of others, and how messages name these.
_NEEDS: tuple[tuple[str, tuple[str, ...], str], ...] = (
    (
        "learn",
        ("reference.kind = re-planning",),
        '[reference] kind = "re-planning": a plan follows no estimate',
    ),
    *(
        (f"control.law = {law}", ("wrist",), "a table [wrist]: it goes by what that measures; may be empty")
        for law, made in LAWS.items()
        if made.needs_wrist
    ),
    ("meet", ("client",), "a table [client]: who is to be met"),
    ("contact", ("meet",), "a table [meet]"),
    ("client", ("meet", "path"), "a table [meet], which may be empty, or a [path]"),
    ("client", ("client.joints", "client.position"), "position, or joints, which meet it by construction"),
    ("client.joints", ("meet",), "a table [meet]; with a [path] give its position"),
    ("client.belief", ("client.sensor",), "a table [client.sensor]: it may be empty"),
    (
        "contact.go",
        ("client.sensor",),
        "a table [client.sensor]: a client that is known needs no go decision",
    ),
    ("meet", ("plan.method = horizon",), '[plan] method = "horizon": the others meet none'),
    ("path.frame = client", ("client",), "a table [client]"),
    ("simulation.wheel_momentum", ("attitude",), "a table [attitude]: the wheels stand still without"),
    ("thrusters", ("attitude",), "a table [attitude]: nothing fires them without; it may be empty"),
    ("estimator", ("sensors",), "a table [sensors]: perfect sensors need none"),
    ("plant.end_effector", ("plant.model",), "model: the plant's own"),
    *(
        (f"plan.mode = {mode}", ("attitude",), f"a table [attitude], with {holder} to hold the base")
        for mode, holder in HELD_BY.items()
    ),
    ("attitude", ("wheels", "robot.wheels", "thrusters"), "[wheels] or [thrusters]"),
    ("attitude.dump", ("wheels", "robot.wheels"), "[wheels] and [thrusters]"),
    ("attitude.dump", ("thrusters",), "[wheels] and [thrusters]"),
    (f"attitude.law = {STATION_KEEPING}", ("thrusters",), "[thrusters]"),
    (
        "attitude.law = coordinated",
        (f"control.law = {COORDINATED_WITH}",),
        f'[control] law = "{COORDINATED_WITH}"',
    ),
    *(
        (
            f"plan.mode = {mode}",
            (f"attitude.{key} = {value}",),
            f'[attitude] {key} = "{value}", to hold the place',
        )
        for mode, holds in {"flying": "both", "translation-flying": "place"}.items()
        for key, value in {"law": STATION_KEEPING, "holds": holds}.items()
    ),
)
# Two conditions that exclude each other, and the message.
_EXCLUDES: tuple[tuple[str, str, str], ...] = (
    ("simulation.v0", "simulation.momentum", "[simulation] has both v0 and momentum; keep one"),
    ("simulation.q0", "control.offset", "[simulation] q0 and [control] offset both move the start; keep one"),
    ("robot.wheels", "robot.mount", "[robot] wheels are joints of a URDF: with [robot.mount] use [wheels]"),
    ("robot.wheels", "wheels", "[robot] wheels and [wheels] both give the wheels; keep one"),
    ("client.joints", "client.position", "[client] joints and position both place it; keep one"),
    ("client.joints", "client.rpy", "[client] joints and rpy both place it; keep one"),
    ("contact.nozzle", "contact.ring", "[contact.nozzle] and [contact.ring] both touch the grasp; keep one"),
    ("attitude.attitude", "attitude.holds = place", '[attitude] attitude is not held: holds = "place"'),
    ("path.attitude", "path.faces", "[path] attitude and faces both give the attitude; keep one"),
    ("path.times", "path.file", "[path] times are those of points; a file has a column t"),
    ("target", "path", "[target] is not for a [path]: the end effector follows the path"),
    ("meet", "path", "[meet] is not for a [path]: a scenario has one of both"),
    ("plan.reach", "path", "[plan] reach is not for a [path]: [path] reach is that of the path"),
    *(
        (without, "meet", f"{what} is not for a capture of a [client]: {instead}")
        for without, what, instead in (
            ("reference.hold", "[reference] hold", "[contact] after is the time that is simulated after it"),
            ("plan.reach", "[plan] reach", "[meet] reach is that of the grasp"),
            ("target", "[target]", "[meet] has the grasp"),
            ("learn", "[learn]", "plans follow factors on the masses; [contact] identify is for the client"),
            ("capture", "[[capture]]", "both give the end effector a body"),
        )
    ),
)


def check_fits(source: Path, tables: _Tables) -> None:
    """Raise `InvalidScenario` where tables of a file do not fit together."""
    for check in (_choices, _conditions, _task, _places):
        for problem in check(tables):
            raise errors.InvalidScenario(source, problem)


def _choices(tables: _Tables) -> Iterator[str]:
    """Find keys that the method, kind, law or shape does not take."""
    replans = tables["reference"].get("kind") == "re-planning"
    for name, chooser, default, takes in TAKES:
        for title, row in _rows(tables, name):
            chosen = row.get(chooser, default)
            for typed in row:
                takers = [choice for choice, keys in takes.items() if typed.removesuffix(DEGREES) in keys]
                if not takers or chosen in takers or (replans and typed in ("effort", "base")):
                    continue
                own = ", ".join(takes.get(chosen, ()))
                takes_it = f'{chooser} = "{takers[0]}" takes it'
                which = f", which takes {own}" if own else ""
                yield f'{title} {typed} is no option of {chooser} = "{chosen}"{which}; {takes_it}'
    method = tables["plan"].get("method", "horizon")
    with_terms = ("horizon", "step") if tables["path"] is None else ("horizon",)
    if tables["term"] and method not in with_terms and not replans:
        yield f'[[term]] is not for [plan] method = "{method}"; "horizon" takes terms'
    for kind, use, keys in _SET_TWICE:
        twice = [key for key in keys if key in tables["plan"]]
        for i, part in enumerate(tables[kind], start=1):
            if part["use"] == use and twice:
                yield f"[plan] {twice[0]} and [[{kind}]] {i} use = '{use}' say the same; keep one"


def _conditions(tables: _Tables) -> Iterator[str]:
    """Find tables, keys and values without what they need, or with what they exclude."""
    for condition, others, message in _EXCLUDES:
        if _given(tables, condition) and _given(tables, others):
            yield message
    for condition, needed, words in _NEEDS:
        if _given(tables, condition) and not any(_given(tables, other) for other in needed):
            yield f"{_title(condition)} needs {words}"
    meet = tables["meet"] or {}
    if meet.get("standoff") == 0.0 and _has(meet, "half_angle"):
        yield "[meet] half_angle is that of the corridor, and standoff = 0 leaves none"


def _given(tables: _Tables, condition: str) -> bool:
    """Return whether a condition holds for a file; keys that choose have their defaults."""
    path, _, value = condition.partition(" = ")
    table, _, key = path.partition(".")
    values = tables[table]
    if value:
        return values is not None and values.get(key, _DEFAULTS.get(path)) == value
    if key:
        return _has(values or {}, key)
    return values is not None if table in NONE_IF_ABSENT else bool(values)


def _title(condition: str) -> str:
    """Return a condition as messages show it."""
    path, _, value = condition.partition(" = ")
    table, _, key = path.partition(".")
    title = f"[{path}]" if is_table(path) else f"[{table}] {key}"
    return f'{title} = "{value}"' if value else title


def _rows(tables: _Tables, name: str) -> Iterator[tuple[str, _Tables]]:
    """Yield the titles and keys of a table, or of each of several."""
    values = tables[name]
    if isinstance(values, tuple):
        yield from ((f"[[{name}]] {i}", row) for i, row in enumerate(values, start=1))
    elif values is not None:
        yield f"[{name}]", values


def _task(tables: _Tables) -> Iterator[str]:
    """Find faults of target, client and path."""
    if tables["path"] is not None:
        yield from _path(tables["path"], tables["client"])
    elif tables["meet"] is None and "position" not in tables["target"]:
        yield "[target] position is missing; it has no default"
    for i, row in enumerate(tables["obstacle"], start=1):
        if row.get("on") == "client" and tables["client"] is None:
            yield f'[[obstacle]] {i} on = "client" needs a table [client]'


def _path(path: _Tables, client: _Tables | None) -> Iterator[str]:
    """Find faults of a path."""
    curve = path["curve"]
    for key in CURVES[curve][0]:
        if key not in path:
            yield f'[path] {key} is missing: curve = "{curve}" needs {" and ".join(CURVES[curve][0])}'
    if curve == "points" and ("points" in path) == ("file" in path):
        yield '[path] curve = "points" needs either points or file'
    if curve == "rounded-square" and 2.0 * path["corner"] > path["side"]:
        yield f"[path] corner must be at most half of the side, got {path['corner']:g}"
    if client is not None and "sensor" in client and path.get("frame") != "client":
        yield '[client.sensor] needs [path] frame = "client": other paths do not follow what it measures'


def _places(tables: _Tables) -> Iterator[str]:
    """Find faults of the target, goals of other frames, and waypoints."""
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
        yield f'[[{several}]] is not for [plan] method = "paper", which has one goal and no waypoints'
    frames = [row["frame"] for row in tables["also"]]
    for i, row in enumerate(tables["also"]):
        yield from _attitude(f"[[also]] {i + 1}", row)
        if row["frame"] in frames[:i]:
            yield f"[[also]] {i + 1} frame = '{row['frame']}' has a goal already"
    duration = tables["plan"].get("duration", Problem.duration)
    names = [row.get("name", f"via {i}") for i, row in enumerate(tables["via"], start=1)]
    for i, row in enumerate(tables["via"]):
        title = f"[[via]] {i + 1}"
        yield from _attitude(title, row)
        if row.get("time", 0.0) > duration:
            yield f"{title} time = {row['time']:g} is after the deadline: [plan] duration is {duration:g}"
        if names[i] in names[:i]:
            yield f"{title} name = '{names[i]}' is there already; give it another one"
        if _has(row, "rpy") and "time" not in row and tables["reference"].get("kind") == "re-planning":
            yield f"{title} needs a time: planning again in the loop cannot see whether a pose was passed"


def _attitude(title: str, place: _Tables) -> Iterator[str]:
    """Find keys of an attitude without one."""
    for key in place:
        if key.removesuffix(DEGREES) in _OF_ATTITUDE and not _has(place, "rpy"):
            yield f"{title} {key} needs an attitude, rpy: without one any will do"


def _has(table: _Tables, key: str) -> bool:
    """Return whether a key is there, in radians or degrees."""
    return key in table or key + DEGREES in table


@contextmanager
def named(source: Path, tables: _Tables, *paths: str) -> Iterator[None]:
    """Raise errors of the library inside the block with the file, and with the key whose value is wrong.

    Parameters
    ----------
    source : Path
    tables : mapping
        The tables of the file.
    *paths : str
        The tables that the block reads, as "friction", "client.sensor" or "via.2" (from 1); the first that
        has the key is named.
    """
    try:
        yield
    except errors.InvalidValue as error:
        raise errors.InvalidScenario(source, _in_words(error, tables, paths)) from None
    except _OF_LOADING as error:
        if str(error).startswith(f"scenario {source}"):
            raise
        title, table = _table(tables, paths[0]) if paths else ("", {})
        keys = ("end_effector", "frame") if isinstance(error, errors.FrameNotFound) else ("model",)
        unclear = isinstance(error, errors.AmbiguousEndEffector | errors.InvalidUrdf)
        key = next((f" {key}:" for key in keys if key in table), "") if not unclear else ""
        message = f"{title}{key} {errors.advised(str(error), _IN_A_FILE)}".lstrip()
        if title not in ("[robot]", "[plant]"):
            raise errors.InvalidScenario(source, message) from None
        error.args = (f"scenario {source}: {message}",)  # what `load` raises stays of its class
        raise


def _table(tables: _Tables, path: str) -> tuple[str, _Tables]:
    """Return the title and the keys of a table."""
    values: Any = tables
    title, row = path, ""
    for step in path.split("."):
        if step.isdecimal():
            values, title, row = values[int(step) - 1], path.rpartition(".")[0], f" {step}"
        else:
            values = values.get(step) or {}
    return (f"[[{title}]]{row}" if row else f"[{title}]"), values


def _in_words(error: errors.InvalidValue, tables: _Tables, paths: tuple[str, ...]) -> str:
    """Return what is wrong with a value, by the key of the file; by the library's name if no key has that."""
    message = errors.advised(str(error), _IN_A_FILE)
    wrong = message.removeprefix(error.name).rpartition(", got ")[0]
    prefix, _, name = error.name.replace(" ", ".").rpartition(".")
    name, entry, _ = name.partition("[")  # an entry belongs to the key of its list
    if isinstance(tables.get(prefix), Mapping):
        paths = (prefix, *paths)
    for path in paths:
        title, table = _table(tables, path)
        if name in table and is_table(f"{path}.{name}"):  # as a whole
            return f"[{path}.{name}]{wrong}, got {errors.short(error.value)}"
        if isinstance(inner := table.get(prefix), Mapping):
            title, table = f"[{path}.{prefix}]", inner
        for key in (name, name + DEGREES):
            if key in table:
                wrong = wrong.replace(" [rad]", "") if key.endswith(DEGREES) else wrong
                value = error.value if entry or isinstance(error.value, str) else table[key]
                return f"{title} {key}{wrong}, got {errors.short(value)}"
    if isinstance(tables.get(prefix), Mapping):
        return f"[{prefix}] {name}{message.removeprefix(error.name)}"
    title = f"{_table(tables, paths[0])[0]} " if len(paths) == 1 and "[" not in error.name else ""
    return f"{title}{message}"
