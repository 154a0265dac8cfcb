"""The goal of the table [path]: a curve in its own axes, which are placed in the axes of the path's frame."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from ffsms_pin import opt
from ffsms_pin.checks import FloatArray, direction
from ffsms_pin.client import FreeBody
from ffsms_pin.errors import InvalidScenario, ResultError
from ffsms_pin.opt.goals.named_curves import CurvePlacement
from ffsms_pin.opt.goals.path_files import PathSamples, path_samples
from ffsms_pin.options.tables import radians
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.scenarios.tables import CURVES

if TYPE_CHECKING:
    from ffsms_pin.scenarios.definition import Scenario


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
            turns = [None] * len(points) if attitudes is None else attitudes
            options["curve"] = list(map(placed.place, points, turns))
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


def _samples(scenario: Scenario, values: Mapping[str, Any]) -> PathSamples:
    """Return the samples of the table, or of its file."""
    if "file" not in values:
        return PathSamples(np.array(values["points"]), None, values.get("times"))
    file = f"[path] file = '{values['file']}'"
    try:
        samples = path_samples(scenario.source.parent / values["file"])
    except ResultError as error:
        raise InvalidScenario(scenario.source, f"{file} {error.problem}") from None
    for name in ("attitude", "faces"):
        if samples.attitudes is not None and name in values:
            raise InvalidScenario(scenario.source, f"{file} has attitudes, and {name} too; keep one")
    return samples
