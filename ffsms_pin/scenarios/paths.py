"""The goal of the table [path]: a curve in its own axes, which are placed in the axes of the path's frame."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from ffsms_pin import opt
from ffsms_pin.checks import FloatArray, direction
from ffsms_pin.client import FreeBody
from ffsms_pin.errors import InvalidScenario, InvalidValue
from ffsms_pin.files import read_content
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.scenarios.keys import radians
from ffsms_pin.system.batch.stacks import cross, rotations

if TYPE_CHECKING:
    from ffsms_pin.scenarios.definition import Scenario

_OPTIONS: tuple[str, ...] = ("tolerance", "orientation_tolerance", "free_axis", "timing", "approach_time")
_OPTIONS += ("reach", "orientation_reach")
_AHEAD = (0.0, 0.0, 1.0)  # default of `free_axis`
_POSITION, _ATTITUDE = ("x", "y", "z"), ("qx", "qy", "qz", "qw")  # columns of a file of points


def _line(s: float, end: tuple[float, ...]) -> FloatArray:
    return np.array([s * x for x in end])


def _circle(s: float, radius: float, turns: float = 1.0) -> FloatArray:
    angle = 2.0 * np.pi * turns * s
    return np.array([radius * np.cos(angle), radius * np.sin(angle), 0.0])


def _helix(s: float, radius: float, rise: float, turns: float = 1.0) -> FloatArray:
    return np.add(_circle(s, radius, turns), [0.0, 0.0, rise * (s - 0.5)])


def _rounded_square(s: float, side: float, corner: float) -> FloatArray:
    """Return a point of the square; each quarter leads from the middle of a side to the next one's."""
    straight, arc = 0.5 * side - corner, 0.5 * np.pi * corner
    quarter, share = divmod(4.0 * s, 1.0)
    way = share * (2.0 * straight + arc)
    before, after = min(way, straight), max(way - straight - arc, 0.0)
    angle = min(max(way - straight, 0.0), arc) / corner
    x, y = straight + corner * np.cos(angle) - after, before + corner * np.sin(angle)
    turn = 0.5 * np.pi * quarter
    return np.array([np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y, 0.0])


_SHAPES: Mapping[str, Callable[..., FloatArray]] = {
    "line": _line,
    "circle": _circle,
    "helix": _helix,
    "rounded-square": _rounded_square,
}
# The required and the optional keys of each kind of curve.
CURVES: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "line": (("end",), ()),
    "circle": (("radius",), ("turns",)),
    "helix": (("radius", "rise"), ("turns",)),
    "rounded-square": (("side", "corner"), ()),
    "points": ((), ("points", "times", "file")),
}


def path_goal(scenario: Scenario, sms: SpaceManipulator, q0: FloatArray, client: FreeBody | None) -> opt.Path:
    """Return the goal of the table [path] for a motion from q0 (nq,), with the scenario's `client`."""
    values = radians(scenario.path)
    kind, frames = values["curve"], {"client": client}
    frame: Any = values.get("frame", "inertial")
    options = {name: values[name] for name in _OPTIONS if name in values}
    if "faces" in values:
        options.setdefault("free_axis", _AHEAD)
    with scenario.named("path"):
        place = partial(_placed, _placement(values, sms, q0, client), _attitude(values))
        curve: Any
        if kind == "points":
            points, attitudes, options["times"] = _samples(scenario, values)
            curve = [place(*row) for row in zip(points, attitudes, strict=True)]
        else:
            keys = (*CURVES[kind][0], *CURVES[kind][1])
            shape = partial(_SHAPES[kind], **{name: values[name] for name in keys if name in values})
            curve, options["parameter"] = lambda s: place(shape(s)), (0.0, 1.0)
        return opt.Path(curve, frame=frames.get(frame, frame), **options)


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


def _attitude(values: Mapping[str, Any]) -> Callable[[FloatArray], FloatArray] | None:
    """Return the attitude (3, 3) of the end effector as a function of the point (3,), in the curve's axes."""
    if "attitude" in values:
        attitude = pin.rpy.rpyToMatrix(np.array(values["attitude"]))
        return lambda point: attitude
    if "faces" not in values:
        return None
    tool = _facing(direction("free_axis", values.get("free_axis", _AHEAD))).T
    inwards = -np.array([1.0, 1.0, values["faces"] == "centre"])
    return lambda point: _facing(inwards * point) @ tool


def _placed(placement: Any, turn: Any, point: FloatArray, attitude: FloatArray | None = None) -> Any:
    """Return a point (3,) of the curve as a position, or as a pose, in the axes of the path's frame."""
    attitude = attitude if turn is None else turn(point)
    return placement.act(point) if attitude is None else placement * pin.SE3(attitude, point)


def _facing(along: FloatArray) -> FloatArray:
    """Return an attitude (3, 3) whose third axis points along (3,), and whose second axis lies across z."""
    length = float(np.linalg.norm(along))
    if length < 1e-9:
        raise InvalidValue("faces", along, "has no direction where the curve meets the axis or centre")
    ahead = along / length
    across = np.array([ahead[1], -ahead[0], 0.0])
    across = across / np.linalg.norm(across) if across.any() else np.array([0.0, 1.0, 0.0])
    return np.column_stack([cross(across, ahead), across, ahead])


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
