"""The goal of the table [path]: a curve in its own axes, which are placed in the axes of the path's frame."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from ffsms_pin import opt
from ffsms_pin.checks import FloatArray, direction
from ffsms_pin.client import FreeBody
from ffsms_pin.errors import InvalidScenario
from ffsms_pin.files import read_content
from ffsms_pin.opt.goals.named_curves import CurvePlacement
from ffsms_pin.options.tables import radians
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.scenarios.tables import CURVES
from ffsms_pin.system.batch.stacks import rotations

if TYPE_CHECKING:
    from ffsms_pin.scenarios.definition import Scenario

_POSITION, _ATTITUDE = ("x", "y", "z"), ("qx", "qy", "qz", "qw")  # columns of a file of points


def path_goal(scenario: Scenario, sms: SpaceManipulator, q0: FloatArray, client: FreeBody | None) -> opt.Path:
    """Return the goal of the table [path] for a motion from q0 (nq,), with the scenario's `client`."""
    values = radians(scenario.path)
    frame = values.get("frame", "inertial")
    options: dict[str, Any] = {"frame": client if frame == "client" else frame}
    if "faces" in values:
        options["free_axis"] = values.get("free_axis", CurvePlacement.tool_axis)
    with scenario.named("path"):
        place = {
            "axes": _placement(values, sms, q0, client),
            "attitude": pin.rpy.rpyToMatrix(np.array(values["attitude"])) if "attitude" in values else None,
            "tool_axis": direction("free_axis", values.get("free_axis", CurvePlacement.tool_axis)),
        }
        if values["curve"] == "points":
            points, attitudes, options["times"] = _samples(scenario, values)
            placed = scenario.made(CurvePlacement, "path", **place)
            options["curve"] = [placed.place(*row) for row in zip(points, attitudes, strict=True)]
        else:
            options["curve"] = scenario.made(CURVES[values["curve"]], "path", **place)
        return scenario.made(opt.Path, "path", **options)


def _placement(values: Mapping[str, Any], sms: SpaceManipulator, q0: FloatArray, client: Any) -> Any:
    """Return the pose (pinocchio.SE3) of the curve's axes in the axes of the path's frame."""
    zero = (0.0, 0.0, 0.0)
    turn = pin.rpy.rpyToMatrix(np.array(values.get("rpy", zero)))
    pose = pin.SE3(turn, np.array(values.get("position", zero)))
    if values.get("relative_to", "frame") == "frame":
        return pose
    tool, frame = sms.at(q0).end_effector_pose, values.get("frame", "inertial")
    if frame == "base":
        tool = pin.XYZQUATToSE3(q0[:7]).actInv(tool)
    elif frame == "client":
        tool = client.pose(0.0).actInv(tool)
    return tool * pose


def _samples(
    scenario: Scenario, values: Mapping[str, Any]
) -> tuple[FloatArray, Sequence[Any], FloatArray | None]:
    """Return the points (K, 3), their attitudes (3, 3) or None, and their times (K,) or None."""
    if "file" not in values:
        points = np.array(values["points"])
        return points, [None] * len(points), values.get("times")
    columns = _columns(scenario.source, values["file"])
    points = np.column_stack([columns[name] for name in _POSITION])
    attitudes: Any = [None] * len(points)
    if "qx" in columns:
        file = f"[path] file = '{values['file']}'"
        for name in ("attitude", "faces"):
            if name in values:
                raise InvalidScenario(scenario.source, f"{file} has attitudes, and {name} too; keep one")
        turns = np.stack([columns[name] for name in _ATTITUDE])
        if (zero := ~turns.any(axis=0)).any():
            row = int(np.argmax(zero)) + 1
            raise InvalidScenario(scenario.source, f"{file}: the quaternion of row {row} is zero")
        attitudes = np.moveaxis(rotations(turns / np.linalg.norm(turns, axis=0)), -1, 0)
    return points, attitudes, columns.get("t")


def _columns(source: Path, name: str) -> dict[str, FloatArray]:
    """Return the named columns of a CSV file of points; raise `InvalidScenario` for any other file."""
    try:
        text = read_content(source.parent / name).decode("utf-8-sig")
        table = np.atleast_1d(np.genfromtxt(io.StringIO(text), delimiter=",", names=True))
    except FileNotFoundError:
        raise InvalidScenario(source, f"[path] file = '{name}' does not exist") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or " ".join(str(error).split())
        raise InvalidScenario(source, f"[path] file = '{name}' cannot be read ({reason})") from None
    names = table.dtype.names or ()
    attitude = [column for column in _ATTITUDE if column in names]
    if (
        set(names) - {"t", *_POSITION, *_ATTITUDE}
        or set(_POSITION) - set(names)
        or len(attitude) in (1, 2, 3)
    ):
        remedy = "must have columns x, y, z, and may have t and qx, qy, qz, qw, named in its first line"
        raise InvalidScenario(source, f"[path] file = '{name}' {remedy}")
    columns = {column: np.asarray(table[column], dtype=np.float64) for column in names}
    for column, numbers in columns.items():
        if not np.isfinite(numbers).all():
            row = int(np.argmin(np.isfinite(numbers))) + 1
            raise InvalidScenario(
                source, f"[path] file = '{name}': {column} of row {row} is no finite number"
            )
    return columns
