"""Checks that the tables of a scenario file fit together."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from ffsms_pin import errors
from ffsms_pin.control import LAWS
from ffsms_pin.opt import Problem
from ffsms_pin.options.messages import is_table
from ffsms_pin.options.tables import DEGREES
from ffsms_pin.scenarios.tables import DEFAULT_LAW, NONE_IF_ABSENT, STATION_KEEPING, ScenarioFile

COORDINATED_WITH = "computed-torque"  # the joint law that the base law "coordinated" needs
OF_HORIZON = ("effort", "base", "time_limit")  # keys of [plan] that only the method "horizon" uses
# Defaults of keys that conditions below compare with a value.
_DEFAULTS = {
    "plan.method": "horizon",
    "control.law": DEFAULT_LAW,
    "attitude.law": "quaternion",
    "reference.kind": "plan",
    "attitude.holds": "both",
}
# Terms and limits that can also be set by keys of [plan].
_SET_TWICE = (
    ("term", "coupling", ("kappa",)),
    ("term", "effort", ("effort",)),
    ("term", "base-turn", ("base",)),
    ("limit", "clearance", ("clearance", "collision")),
    ("limit", "base", ("base_limits",)),
)
# Keys that need the key `rpy` in their table.
_OF_ATTITUDE = ("spin", "arrival_spin", "orientation_reach")

_Tables = Mapping[str, Any]

_OTHERS = "{}; other methods do not use it"
_SENSOR = "a table {}, its sensor; may be empty"
_ATTITUDE = "attitude, faces, or a file with attitudes"

# Conditions are tables, keys or values of keys: "attitude", "attitude.dump", "attitude.law = coordinated".
# A row has a condition, its requirements (conditions separated by |), and the end of the message. If the
# condition holds, at least one requirement must hold, too. In the message {} is the first requirement.
_NEEDS: tuple[tuple[str, str, str], ...] = (
    # Re-planning uses effort and base even if the first plan has another method.
    ("plan.effort", "plan.method = horizon | reference.kind = re-planning", _OTHERS),
    ("plan.base", "plan.method = horizon | reference.kind = re-planning", _OTHERS),
    ("plan.time_limit", "plan.method = horizon", _OTHERS),
    ("learn", "reference.kind = re-planning", "{}, because a motion planned once uses no estimate"),
    *((f"control.law = {law}", "wrist", _SENSOR) for law, made in LAWS.items() if made.needs_wrist),
    ("meet", "client", "a table {}"),
    ("contact", "meet", "a table {}"),
    ("client", "meet | path", "a table {}, which may be empty, or a [path]"),
    ("client", "client.position | client.joints", "position, or joints for a reachable grasp"),
    ("client.joints", "meet", "a table {}; with a [path] give the client's position"),
    ("client.belief", "client.sensor", "a table {}, which may be empty"),
    ("contact.go", "client.sensor", "a table {}, because a known client needs no go decision"),
    ("path.frame = client", "client", "a table {}"),
    ("path.orientation_tolerance", "path.attitude | path.faces | path.file", _ATTITUDE),
    ("path.orientation_reach", "path.attitude | path.faces | path.file", _ATTITUDE),
    ("simulation.wheel_momentum", "attitude", "a table {}, without which the wheels stand still"),
    ("thrusters", "attitude", "a table {}, without which they never fire; it may be empty"),
    ("estimator", "sensors", "a table {}, because perfect sensors need no estimator"),
    ("plant.end_effector", "plant.model", "model, the robot that has this frame"),
    ("plan.mode = rotation-floating", "attitude", "a table {}, with wheels to hold the base"),
    ("plan.mode = rotation-flying", "attitude", "a table {}, with thrusters to hold the base"),
    ("plan.mode = translation-flying", "attitude", "a table {}, with thrusters to hold the base"),
    ("plan.mode = flying", "attitude", "a table {}, with thrusters to hold the base"),
    ("attitude", "wheels | robot.wheels | thrusters", "{} or [thrusters]"),
    ("attitude.dump", "wheels | robot.wheels", "{} and [thrusters]"),
    ("attitude.dump", "thrusters", "[wheels] and {}"),
    (f"attitude.law = {STATION_KEEPING}", "thrusters", "{}"),
    ("attitude.law = coordinated", f"control.law = {COORDINATED_WITH}", "{}"),
    ("plan.mode = flying", f"attitude.law = {STATION_KEEPING}", "{}, to hold the place"),
    ("plan.mode = flying", "attitude.holds = both", "{}, to hold the place"),
    ("plan.mode = translation-flying", f"attitude.law = {STATION_KEEPING}", "{}, to hold the place"),
    ("plan.mode = translation-flying", "attitude.holds = place", "{}, to hold the place"),
    ("path.curve = points", "path.points | path.file", "either points or file"),
    ("client.sensor", "path.frame = client | meet", "{}, because other paths do not use its measurements"),
)
# Two conditions that exclude each other, and the message.
_EXCLUDES: tuple[tuple[str, str, str], ...] = (
    ("simulation.v0", "simulation.momentum", "[simulation] has both v0 and momentum; keep one"),
    ("simulation.q0", "control.offset", "[simulation] q0 and [control] offset both move the start; keep one"),
    ("robot.wheels", "robot.mount", "[robot] wheels are joints of a URDF: with [robot.mount] use [wheels]"),
    ("robot.wheels", "wheels", "[robot] wheels and [wheels] both define the wheels; keep one"),
    ("client.joints", "client.position", "[client] joints and position both place the client; keep one"),
    ("client.joints", "client.rpy", "[client] joints and rpy both place the client; keep one"),
    ("contact.nozzle", "contact.ring", "[contact.nozzle] and [contact.ring] both touch the grasp; keep one"),
    ("attitude.attitude", "attitude.holds = place", '[attitude] attitude is not held: holds = "place"'),
    ("path.times", "path.file", "[path] times are for points; write the times of a file into its column t"),
    ("target", "path", "[target] is not for a [path]: the end effector follows the path"),
    ("meet", "path", "[meet] and [path] exclude each other; keep one"),
    ("plan.reach", "path", "[plan] reach is not for a [path]: use [path] reach"),
    ("reference.hold", "meet", "[reference] hold is not for a capture of a [client]: use [contact] after"),
    ("plan.reach", "meet", "[plan] reach is not for a capture of a [client]: use [meet] reach"),
    ("target", "meet", "[target] is not for a capture of a [client]: use [meet] grasp"),
    ("learn", "meet", "[learn] is not for a capture of a [client]: use [contact] identify"),
    (
        "capture",
        "meet",
        "[[capture]] is not for a capture of a [client]: both attach a body to the end effector",
    ),
    (
        "meet.half_angle",
        "meet.standoff = 0.0",
        "[meet] half_angle needs a corridor, which standoff = 0 switches off",
    ),
    ("path.points", "path.file", '[path] curve = "points" needs either points or file'),
)


def check_fits(source: Path, tables: _Tables) -> None:
    """Raise `InvalidScenario` if tables of a file do not fit together."""
    for check in (_parts, _conditions, _places):
        for problem in check(tables):
            raise errors.InvalidScenario(source, problem)


def _parts(tables: _Tables) -> Iterator[str]:
    """Yield messages about terms that the method does not use, and about values that [plan] sets too."""
    replans = tables["reference"].get("kind") == "re-planning"
    method = tables["plan"].get("method", "horizon")
    with_terms = ("horizon", "step") if tables["path"] is None else ("horizon",)
    if tables["term"] and method not in with_terms and not replans:
        yield f'[[term]] is not for [plan] method = "{method}"; "horizon" takes terms'
    for kind, use, keys in _SET_TWICE:
        twice = [key for key in keys if key in tables["plan"]]
        for i, part in enumerate(tables[kind], start=1):
            if part["use"] == use and twice:
                yield f"[plan] {twice[0]} and [[{kind}]] {i} use = '{use}' set the same; keep one"


def _conditions(tables: _Tables) -> Iterator[str]:
    """Yield messages about tables, keys and values that need or exclude others."""
    for condition, other, message in _EXCLUDES:
        if _holds(tables, condition) and _holds(tables, other):
            yield message
    for condition, others, requirement in _NEEDS:
        needed = others.split(" | ")
        if _holds(tables, condition) and not any(_holds(tables, other) for other in needed):
            yield f"{_title(condition)} needs {requirement.format(_title(needed[0]))}"


def _holds(tables: _Tables, condition: str) -> bool:
    """Return whether a condition holds; a missing key has its default."""
    path, _, value = condition.partition(" = ")
    table, _, key = path.partition(".")
    values = tables[table]
    if value:
        return values is not None and str(values.get(key, _DEFAULTS.get(path))) == value
    if key:
        return _has(values or {}, key)
    return values is not None if table in NONE_IF_ABSENT else bool(values)


def _title(condition: str) -> str:
    """Return a condition as text for messages."""
    path, _, value = condition.partition(" = ")
    table, _, key = path.partition(".")
    title = f"[{path}]" if is_table(ScenarioFile, path) else f"[{table}] {key}"
    return f'{title} = "{value}"' if value else title


def _places(tables: _Tables) -> Iterator[str]:
    """Yield messages about obstacles, the target, goals of other frames, and waypoints."""
    target = tables["target"]
    if tables["path"] is None and tables["meet"] is None and "position" not in target:
        yield "[target] position is missing; it has no default"
    for i, row in enumerate(tables["obstacle"], start=1):
        if row.get("on") == "client" and tables["client"] is None:
            yield f'[[obstacle]] {i} on = "client" needs a table [client]'
    yield from _attitude("[target]", target)
    moves = [key for key in ("velocity", "spin", "spin" + DEGREES) if any(target.get(key, ()))]
    arrives = [key for key in target if key.startswith("arrival_")]
    if moves and arrives:
        yield (
            f"[target] {arrives[0]} is for a target at rest; with {moves[0]} the end effector "
            "arrives with the target's velocity"
        )
    turns = [key for key in arrives if key.startswith("arrival_spin")]
    if turns and "arrival_velocity" not in target:
        yield f"[target] {turns[0]} needs arrival_velocity too; it may be [0, 0, 0]"
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
            yield f"{title} name = '{names[i]}' is used twice; choose another name"
        if _has(row, "rpy") and "time" not in row and tables["reference"].get("kind") == "re-planning":
            yield f"{title} needs a time, because re-planning cannot detect that a pose was passed"


def _attitude(title: str, place: _Tables) -> Iterator[str]:
    """Yield messages about keys of a table that need the key `rpy`, if the table has no such key."""
    for key in place:
        if key.removesuffix(DEGREES) in _OF_ATTITUDE and not _has(place, "rpy"):
            yield f"{title} {key} needs an attitude: add rpy"


def _has(table: _Tables, key: str) -> bool:
    """Return whether a key is present, in radians or degrees."""
    return key in table or key + DEGREES in table
