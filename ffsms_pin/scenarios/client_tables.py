"""Tables of a scenario file about a client: what it is, how it is met, and how it is caught."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ffsms_pin.errors import InvalidScenario
from ffsms_pin.scenarios.table import DEGREES, Table
from ffsms_pin.scenarios.values import (
    either,
    flag,
    matrix,
    not_negative,
    numbers,
    one_of,
    positive,
    whole,
)

__all__ = ["CLIENT", "CONTACT", "MEET", "check_client"]

_NOISE = ("position_noise", "attitude_noise", "velocity_noise", "rate_noise")

CLIENT = Table(
    {
        "mass": positive,
        "inertia": either(numbers(3, positive), matrix(3, 3)),
        "position": numbers(3),
        "rpy": numbers(3),
        "joints": numbers(),
        "velocity": numbers(3),
        "spin": numbers(3),
        "size": numbers(3, positive),
    },
    frozenset({"rpy", "joints", "spin"}),
    required=("mass", "inertia"),
    tables={
        "sensor": Table(
            {
                **dict.fromkeys(_NOISE, positive),
                "latency": not_negative,
                "period": positive,
                "seed": whole(0),
            },
            frozenset({"attitude_noise", "rate_noise"}),
            none_if_absent=True,
        )
    },
    none_if_absent=True,
)

MEET = Table(
    {
        "grasp": numbers(3),
        "grasp_rpy": numbers(3),
        "standoff": not_negative,
        "half_angle": positive,
        "axis": numbers(3),
        "tolerance": positive,
        "rest_after": flag,
    },
    frozenset({"grasp_rpy", "half_angle"}),
    none_if_absent=True,
)

CONTACT = Table(
    {
        "kind": one_of("rigid", "compliant"),
        "stiffness": positive,
        "damping": not_negative,
        "turn_stiffness": positive,
        "turn_damping": not_negative,
        "time": positive,
        "torque_share": positive,
        "after": not_negative,
    }
)

_OF_COMPLIANCE = ("stiffness", "damping", "turn_stiffness", "turn_damping", "time")


def check_client(source: Path, tables: Mapping[str, Any]) -> None:
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
