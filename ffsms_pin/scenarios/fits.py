"""What tables of a scenario file must fit together: alternatives, and keys that need another table."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ffsms_pin.control import LAWS
from ffsms_pin.errors import InvalidScenario
from ffsms_pin.scenarios.actuated import COORDINATED_WITH, STATION_KEEPING
from ffsms_pin.scenarios.keys import DEGREES
from ffsms_pin.scenarios.plan_tables import HELD_BY

__all__ = ["DEFAULT_LAW", "check_fits", "gains_of"]

DEFAULT_LAW = "sliding-mode"
# What this law holds in the modes of a plan that hold the base's place.
STATIONS = {"flying": "both", "translation-flying": "place"}
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


def gains_of(law: str) -> tuple[str, ...]:
    """Names of a control law's gains."""
    others = ("sms", "dt", "torque_limit")
    return tuple(name for name in inspect.signature(LAWS[law]).parameters if name not in others)


def check_fits(source: Path, tables: Mapping[str, Any]) -> None:
    """Raise `InvalidScenario` where tables of a file do not fit together."""
    _check_gains(source, tables)
    _check_alternatives(source, tables)
    _check_base(source, tables)
    _check_client(source, tables)
    _check_places(source, tables)
    if "mount" in tables["robot"] and "wheels" in tables["robot"]:
        raise InvalidScenario(
            source, "[robot] wheels are joints of a whole robot's URDF: with [robot.mount] use [wheels]"
        )


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


_OF_COMPLIANCE = ("stiffness", "damping", "turn_stiffness", "turn_damping", "time")


def _check_client(source: Path, tables: Mapping[str, Any]) -> None:
    """Raise `InvalidScenario` where target, client, meeting and contact do not fit together."""
    client, meet = tables["client"], tables["meet"]
    if meet is not None and client is None:
        raise InvalidScenario(source, "[meet] needs a table [client]: who is to be met")
    if client is not None and meet is None:
        raise InvalidScenario(source, "[client] needs a table [meet]; it may be empty")
    if meet is not None and "position" in tables["target"]:
        raise InvalidScenario(source, "[target] and [meet] both say where to go; keep one")
    if meet is None and "position" not in tables["target"]:
        raise InvalidScenario(source, "[target] position is missing; it has no default")
    if client is None:
        for i, one in enumerate(tables["obstacle"], start=1):
            if one.get("on") == "client":
                raise InvalidScenario(source, f'[[obstacle]] {i} on = "client" needs a table [client]')
        if tables["contact"]:
            raise InvalidScenario(source, "[contact] needs a table [client]")
        return
    if tables["capture"]:
        raise InvalidScenario(source, "[[capture]] and [client] both give the end effector a body; keep one")
    if tables["plan"].get("method", "horizon") != "horizon":
        raise InvalidScenario(source, '[plan] method must be "horizon" for a client: the others meet none')
    built = {"joints", "joints" + DEGREES} & client.keys()
    placed = {"position", "rpy", "rpy" + DEGREES} & client.keys()
    if built and placed:
        raise InvalidScenario(source, "[client] joints and position both place it; keep one")
    if not built and "position" not in client:
        raise InvalidScenario(
            source, "[client] position is missing (or joints, which meet it by construction)"
        )
    if client.get("sensor") is not None and tables["reference"].get("kind", "plan") == "plan":
        raise InvalidScenario(source, '[client.sensor] needs [reference] kind = "re-planning"')
    for key in _OF_COMPLIANCE:
        if key in tables["contact"] and tables["contact"].get("kind", "rigid") == "rigid":
            raise InvalidScenario(source, f'[contact] {key} needs kind = "compliant"')


_DURATION = 12.0  # [s] `plan`'s default
# Keys that say nothing of a place with any attitude.
_OF_ATTITUDE = ("spin", "arrival_spin", "orientation_reach")


def _check_places(source: Path, tables: Mapping[str, Any]) -> None:
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
