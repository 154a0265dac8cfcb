"""Obstacles of a scenario file: [[obstacle]] tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from ffsms_pin.errors import FfsmsError, InvalidScenario
from ffsms_pin.opt import Obstacle
from ffsms_pin.scenarios.keys import DEGREES
from ffsms_pin.storage import LARGEST_DATA, check_readable

__all__ = ["SHAPE_KEYS", "made_obstacles"]

SHAPE_KEYS: Mapping[str, tuple[str, ...]] = {
    "box": ("size",),
    "sphere": ("radius",),
    "cylinder": ("radius", "length"),
    "capsule": ("radius", "length"),
    "mesh": ("file",),
}
"""Keys that each shape needs."""

_SIZES = ("size", "radius", "length", "file", "scale")


def made_obstacles(source: Path, rows: Sequence[Mapping[str, Any]], client: Any = None) -> list[Obstacle]:
    """The obstacles of a scenario file.

    Parameters
    ----------
    source : Path
        The file, for messages; meshes are looked for from its folder.
    rows : sequence of mapping
        The tables.
    client : Client or ClientEstimate, optional
        What those with on = "client" are on. Default: they are left out.

    Raises
    ------
    InvalidScenario
        Keys do not fit the shape, or a mesh is not there, cannot be read, or is not convex.
    """
    return [
        _obstacle(source, f"[[obstacle]] {i}", row, client)
        for i, row in enumerate(rows, start=1)
        if client is not None or row.get("on") != "client"
    ]


def _obstacle(source: Path, title: str, row: Mapping[str, Any], client: Any) -> Obstacle:
    kind = row["shape"]
    needed = SHAPE_KEYS[kind]
    for key in needed:
        if key not in row:
            raise InvalidScenario(source, f"{title} {key} is missing: a {kind} needs {' and '.join(needed)}")
    allowed = (*needed, "scale") if kind == "mesh" else needed
    for key in _SIZES:
        if key in row and key not in allowed:
            raise InvalidScenario(
                source, f"{title} {key} says nothing of a {kind}, which has {' and '.join(allowed)}"
            )
    angles = row.get("rpy", np.deg2rad(row.get("rpy" + DEGREES, (0.0, 0.0, 0.0))))
    place = pin.SE3(pin.rpy.rpyToMatrix(np.array(angles)), np.array(row.get("position", (0.0, 0.0, 0.0))))
    try:
        return Obstacle(
            _shape(source, title, kind, row),
            place,
            client if row.get("on") == "client" else row.get("on", "inertial"),
            row.get("margin", 0.0),
            row.get("name", ""),
        )
    except FfsmsError as error:
        if isinstance(error, InvalidScenario):
            raise
        raise InvalidScenario(source, f"{title}: {error}") from None


def _shape(source: Path, title: str, kind: str, row: Mapping[str, Any]) -> Any:
    if kind == "box":
        return coal.Box(*row["size"])
    if kind == "sphere":
        return coal.Sphere(row["radius"])
    if kind == "cylinder":
        return coal.Cylinder(row["radius"], row["length"])
    if kind == "capsule":
        return coal.Capsule(row["radius"], row["length"])
    path = source.parent / row["file"]
    try:
        check_readable(path, LARGEST_DATA)
        return coal.MeshLoader().load(str(path), np.full(3, row.get("scale", 1.0)))
    except FileNotFoundError:
        raise InvalidScenario(source, f"{title} file = '{row['file']}' is not there") from None
    except Exception as error:  # of the mesh readers: each has its own kinds
        raise InvalidScenario(source, f"{title} file = '{row['file']}' cannot be read ({error})") from None
