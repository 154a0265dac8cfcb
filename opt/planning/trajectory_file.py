"""Trajectories in npz files: which arrays there are, of which shapes."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from ffsms_pin.errors import ResultError
from ffsms_pin.opt.goals.goal import TOLERANCE
from ffsms_pin.storage import check_shapes, check_times, load_arrays, numbers_by_name, save_arrays
from ffsms_pin.system.base_reaction import MODES

__all__ = ["read", "write"]

_FORMAT = "ffsms-pin trajectory"
_TEXTS = ("shares", "binding", "broken")  # kept as JSON
_NUMBERS = ("kappa", "reach", "orientation_reach", "shortest_duration", "wheel_energy", "propellant")
_ANSWERS = ("clear", "met", "within_tolerance")
_WORDS = ("note", "mode")
_SHAPES: dict[str, tuple[str | int, ...]] = {
    "t": ("N+1",),
    "v": ("N+1", "n+6"),
    "q": ("N+1", "nq"),
    "joint_positions": ("N+1", "n"),
    "end_effector": ("N+1", 3),
    "target": (3,),
    "target_rotation": (3, 3),
    "contact_velocity": (6,),
    "momentum": (6,),
    "wheel_momentum": ("N+1", "w"),
    "torque_share": ("N+1", "n"),
    **dict.fromkeys(("joint_accelerations", "alpha"), ("N", "n")),
    **dict.fromkeys(("cos_theta", "entropy", "cost"), ("N",)),
    **dict.fromkeys(("position_error", "orientation_error"), ("N+1",)),
    **dict.fromkeys((*_NUMBERS, *_ANSWERS, *_WORDS, *_TEXTS), ()),
}


def write(path: str | os.PathLike[str], values: dict[str, Any]) -> None:
    """Write a trajectory's fields, atomically."""
    arrays = dict(values)
    for name in _TEXTS:
        arrays[name] = json.dumps(arrays[name], default=lambda array: array.tolist())
    save_arrays(path, _FORMAT, arrays)


def read(path: str | os.PathLike[str]) -> dict[str, Any]:
    """What `write` wrote; a `ResultError` says what is wrong with another file."""
    # Files from before there was momentum, or before there were terms, clients, wheels or modes, have none.
    none, unknown, known = np.zeros((0, 0)), np.array(True), True
    before = {
        "momentum": np.zeros(6),
        "contact_velocity": np.zeros(6),
        "met": np.array(True),
        "within_tolerance": unknown,
        "mode": np.array("floating"),
        **dict.fromkeys(("wheel_momentum", "torque_share"), none),
        **dict.fromkeys(("wheel_energy", "propellant"), np.zeros(())),
        **{name: np.array("{}") for name in _TEXTS},
    }
    kinds = dict.fromkeys(_ANSWERS, "b") | dict.fromkeys((*_WORDS, *_TEXTS), "U")

    def check(heads: Mapping[str, Any]) -> None:
        nonlocal known
        known = heads["within_tolerance"] is not unknown
        for name, columns in (("wheel_momentum", 0), ("torque_share", heads["alpha"].shape[-1:])):
            if heads[name] is none:
                heads = {**heads, name: np.zeros((*heads["t"].shape[:1], *np.atleast_1d(columns)))}
        check_shapes(path, heads, _SHAPES, kinds)

    arrays = load_arrays(path, _FORMAT, list(_SHAPES), before, check)
    check_times(path, arrays["t"], least=2)
    for name in _TEXTS:
        arrays[name] = numbers_by_name(path, name, str(arrays[name]), rows=name == "binding")
    for kind, names in ((float, _NUMBERS), (bool, _ANSWERS), (str, _WORDS)):
        arrays |= {name: kind(arrays[name]) for name in names}
    if not known:  # nor which velocities were asked for, but whether those of a client were met
        misses = (arrays[f"{kind}_error"][-1] for kind in ("position", "orientation"))
        arrays["within_tolerance"] = arrays["met"] and bool(max(misses) <= TOLERANCE)
    if arrays["mode"] not in MODES:
        raise ResultError(path, f"its 'mode' is '{arrays['mode']}', none of {', '.join(MODES)}")
    return arrays
