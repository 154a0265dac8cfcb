"""The tables of a scenario file and their keys; docs/scenarios.md says what each means."""

from __future__ import annotations

import inspect
from collections.abc import Mapping

from ffsms_pin.control import LAWS
from ffsms_pin.opt import METHODS
from ffsms_pin.scenarios.base_tables import ATTITUDE, THRUSTERS, WHEELS
from ffsms_pin.scenarios.client_tables import CLIENT, CONTACT, MEET
from ffsms_pin.scenarios.place_tables import ALSO, TARGET, VIA
from ffsms_pin.scenarios.table import DEGREES, Table, radians
from ffsms_pin.scenarios.values import (
    Parser,
    either,
    flag,
    gain,
    matrix,
    named_numbers,
    not_negative,
    number,
    numbers,
    one_of,
    or_infinite,
    per_joint,
    positive,
    table,
    text,
    texts,
    whole,
)
from ffsms_pin.simulation import INTEGRATORS

__all__ = ["DEFAULT_LAW", "DEGREES", "HELD_BY", "TABLES", "Table", "gains_of", "radians"]

DEFAULT_LAW = "sliding-mode"
#: Modes of a plan that a closed loop can follow, and what then holds the attitude.
HELD_BY = {
    "rotation-floating": "wheels",
    "rotation-flying": "thrusters",
    "translation-flying": "thrusters",
    "flying": "thrusters",
}


def gains_of(law: str) -> tuple[str, ...]:
    """Names of a control law's gains."""
    others = ("sms", "dt", "torque_limit")
    return tuple(name for name in inspect.signature(LAWS[law]).parameters if name not in others)


_GAINS: Mapping[str, Parser] = {
    **dict.fromkeys(("K_s", "K_p", "K_d", "Gamma"), gain),
    **dict.fromkeys(("boundary", "k_1", "k_2"), per_joint(positive)),
}

_SIZE = or_infinite(positive)
_MARGIN = or_infinite(not_negative)
_SHIFTS = either(numbers(3), matrix(None, 3))
_WEIGHT = {"weight": not_negative}
_CLEARANCE: Mapping[str, Parser] = {
    "clearance": not_negative,
    "collision": one_of("auto", "points", "hulls", "shapes", "off"),
}
_BASE_LIMITS = Table(
    {"attitude": _SIZE, "attitude_rate": _SIZE, "translation": _SIZE, "final_attitude": _SIZE},
    frozenset({"attitude", "attitude_rate", "final_attitude"}),
)

TABLES: Mapping[str, Table] = {
    "robot": Table(
        {
            "model": text,
            "end_effector": text,
            "base_size": numbers(3, positive),
            "wheels": texts,
            "locked": named_numbers,
            "velocity": per_joint(positive),
            "acceleration": per_joint(positive),
            "torque": per_joint(positive),
            "inertias": one_of("check", "keep", "repair"),
        },
        frozenset({"locked", "velocity", "acceleration"}),
        required=("model",),
    ),
    "start": Table(
        {"joints": numbers(), "joint_rates": per_joint()},
        frozenset({"joints", "joint_rates"}),
        required=("joints",),
    ),
    "target": TARGET,
    "also": ALSO,
    "via": VIA,
    "client": CLIENT,
    "meet": MEET,
    "contact": CONTACT,
    "plan": Table(
        {
            "duration": positive,
            "dt": positive,
            "kappa": positive,
            **_CLEARANCE,
            "method": one_of(*METHODS),
            "reach": positive,
            "momentum": numbers(6),
            "effort": not_negative,
            "base": not_negative,
            "time_limit": positive,
            "locked": texts,
            "mode": one_of("floating", *HELD_BY),
        },
        tables={"base_limits": _BASE_LIMITS},
    ),
    "term": Table(
        {},
        several=True,
        by_use={
            "coupling": Table({"kappa": positive, "weight": positive}),
            "smooth": Table(_WEIGHT),
            "effort": Table(_WEIGHT),
            "base-turn": Table(_WEIGHT),
            "wheel-momentum": Table(_WEIGHT),
            "wheel-energy": Table({**_WEIGHT, "rounding": positive}),
            "propellant": Table({**_WEIGHT, "rounding": positive}),
        },
    ),
    "limit": Table(
        {},
        several=True,
        by_use={
            "joints": Table({}),
            "clearance": Table(_CLEARANCE),
            "base": _BASE_LIMITS,
            "alpha-box": Table({}),
            "torques": Table({}),
            "wheels": Table({}),
        },
    ),
    "obstacle": Table(
        {
            "name": text,
            "shape": one_of("box", "sphere", "cylinder", "capsule", "mesh"),
            "size": numbers(3, positive),
            "radius": positive,
            "length": positive,
            "file": text,
            "scale": positive,
            "position": numbers(3),
            "rpy": numbers(3),
            "on": one_of("inertial", "base", "client"),
            "margin": not_negative,
        },
        frozenset({"rpy"}),
        required=("shape",),
        several=True,
    ),
    "limits": Table(
        {
            "lower": per_joint(),
            "upper": per_joint(),
            "velocity": per_joint(positive),
            "acceleration": per_joint(positive),
            "torque": per_joint(positive),
        },
        frozenset({"lower", "upper", "velocity", "acceleration"}),
    ),
    "control": Table(
        {
            "law": one_of(*LAWS),
            **_GAINS,
            "torque_limit": per_joint(_SIZE),
            "dt": positive,
            "offset": per_joint(),
        },
        frozenset({"offset"}),
    ),
    "laws": Table({}, tables={law: Table({name: _GAINS[name] for name in gains_of(law)}) for law in LAWS}),
    "reference": Table(
        {
            "kind": one_of("plan", "re-planning"),
            "dt": positive,
            "hold": not_negative,
            "dead_band": not_negative,
            "jerk": per_joint(positive),
        },
        frozenset({"jerk"}),
    ),
    "simulation": Table(
        {
            "integrator": one_of(*INTEGRATORS),
            "momentum": numbers(6),
            "q0": numbers(),
            "v0": numbers(),
            "wheel_momentum": numbers(),
            "stream": text,
        }
    ),
    "plant": Table(
        {
            "model": text,
            "end_effector": text,
            "arm_mass": per_joint(positive),
            "arm_inertia": per_joint(positive),
            "arm_com": _SHIFTS,
            "base_mass": positive,
            "base_inertia": positive,
            "base_com": numbers(3),
        },
        tables={
            "random": Table(
                {
                    "seed": whole(0),
                    "arm_mass": not_negative,
                    "base_mass": not_negative,
                    "base_inertia": not_negative,
                },
                required=("seed",),
            )
        },
    ),
    "wheels": WHEELS,
    "thrusters": THRUSTERS,
    "attitude": ATTITUDE,
    "friction": Table(
        {"viscous": per_joint(not_negative), "coulomb": per_joint(not_negative), "transition": positive},
        frozenset({"transition"}),
    ),
    "actuator": Table(
        {"torque_limit": per_joint(_SIZE), "rate_limit": per_joint(_SIZE), "delay": not_negative}
    ),
    "sensors": Table(
        {
            "joint_resolution": not_negative,
            "joint_noise": not_negative,
            "joint_rate_noise": not_negative,
            "base_position_noise": not_negative,
            "base_attitude_noise": not_negative,
            "base_velocity_noise": not_negative,
            "base_rate_noise": not_negative,
            "base_latency": not_negative,
            "seed": whole(0),
        },
        frozenset(
            {"joint_resolution", "joint_noise", "joint_rate_noise", "base_attitude_noise", "base_rate_noise"}
        ),
    ),
    "estimator": Table(
        {
            "on": flag,
            "joint_acceleration": not_negative,
            "base_acceleration": not_negative,
            "base_angular_acceleration": not_negative,
        }
    ),
    "disturbance": Table(
        {
            "wrench": numbers(6),
            "on": one_of("base", "end-effector"),
            "start": number,
            "end": or_infinite(number),
        },
        required=("wrench",),
        several=True,
    ),
    "capture": Table(
        {
            "time": not_negative,
            "mass": positive,
            "inertia": either(numbers(3, positive), matrix(3, 3)),
            "com": numbers(3),
            "twist": numbers(6),
        },
        required=("time", "mass", "inertia"),
        several=True,
    ),
    "fault": Table(
        {
            "time": not_negative,
            "joint": lambda value: text(value) if isinstance(value, str) else whole(0)(value),
            "kind": one_of("locked", "limp"),
            "told": flag,
        },
        required=("time", "joint"),
        several=True,
    ),
    "watchdog": Table(
        {
            "position_margin": _MARGIN,
            "rate_margin": _MARGIN,
            "joint_error": _MARGIN,
            "failed_steps": whole(1),
            "path": text,
        },
        frozenset({"position_margin", "joint_error"}),
        none_if_absent=True,
    ),
    # What the distributions may be, `ffsms_pin.campaigns` says: a single run has no use for them.
    "campaign": Table({"seed": whole(0), "draw": table}),
}
"""Of a whole file, by name."""
