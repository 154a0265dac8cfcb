"""Tables of a scenario file about what acts on the base: wheels, thrusters and their law."""

from __future__ import annotations

from ffsms_pin.scenarios.table import Table
from ffsms_pin.scenarios.values import (
    flag,
    matrix,
    not_negative,
    numbers,
    one_of,
    or_infinite,
    per_joint,
    positive,
    texts,
)

__all__ = ["ATTITUDE", "STATIONS", "STATION_KEEPING", "THRUSTERS", "WHEELS"]

STATION_KEEPING = "station-keeping"  # the law that holds the base's place
# What this law holds in the modes of a plan that hold the base's place.
STATIONS = {"flying": "both", "translation-flying": "place"}

_ROWS = matrix(None, 3)

WHEELS = Table(
    {
        "axes": _ROWS,
        "inertia": per_joint(positive),
        "torque": per_joint(or_infinite(positive)),
        "momentum": per_joint(or_infinite(positive)),
        "friction": per_joint(not_negative),
        "coulomb": per_joint(not_negative),
        "transition": positive,
        "names": texts,
    },
    required=("axes", "inertia"),
    none_if_absent=True,
)

THRUSTERS = Table(
    {
        "places": _ROWS,
        "directions": _ROWS,
        "force": per_joint(positive),
        "least_on_time": not_negative,
        "proportional": flag,
        "specific_impulse": positive,
        "period": positive,
    },
    required=("places", "directions", "force"),
    none_if_absent=True,
)

ATTITUDE = Table(
    {
        "law": one_of("quaternion", "coordinated", STATION_KEEPING),
        "holds": one_of("both", "place"),
        "bandwidth": positive,
        "damping": positive,
        "feedforward": one_of("torque", "plan", "none"),
        "attitude": numbers(3),
        "place": numbers(3),
    },
    frozenset({"attitude"}),
    tables={
        "dump": Table(
            {"above": positive, "below": not_negative, "time_constant": positive}, none_if_absent=True
        )
    },
    none_if_absent=True,
)
