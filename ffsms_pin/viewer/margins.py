"""How much room is left: joints coloured by their limits, and the nearest pair of the paper's points."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.limits.clearance.bodies import PointStack
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.viewer.colours import usage_colour
from ffsms_pin.viewer.frames import Frames
from ffsms_pin.viewer.meshes import along_z, tube
from ffsms_pin.viewer.stage import Stage

__all__ = ["ClearanceLayer", "LimitLayer", "limit_usage"]

_SAFE, _FREE = 0.01, 0.10  # [m] the paper's d_safe, and where room is plenty


class LimitLayer:
    """A ball about each joint, coloured by how much of its position or rate limit is used, the larger."""

    def __init__(self, stage: Stage, frames: Frames) -> None:
        self._stage = stage
        self._data = frames.sms.model.createData()
        for i in range(frames.sms.n):
            stage.ball(f"joint limits/{i + 1}", 0.03 * stage.size, "#FFFFFF", opacity=0.85)

    def show(self, frames: Frames, k: int) -> None:
        """Place and colour the balls as in frame k."""
        pin.forwardKinematics(frames.sms.model, self._data, frames.q[k])
        usage = limit_usage(frames.sms, frames.q[k], frames.v[k])
        for i in range(frames.sms.n):
            name = f"joint limits/{i + 1}"
            self._stage.place(name, np.array(self._data.oMi[i + 2].translation))
            self._stage.tint(name, usage_colour(float(usage[i])))


class ClearanceLayer:
    """A rod between the two of the paper's points, or the point and the base box, that are nearest."""

    def __init__(self, stage: Stage, frames: Frames) -> None:
        self._stage = stage
        self._points = PointStack(frames.sms)
        self._data = frames.sms.model.createData()
        rod = tube(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), 0.008 * stage.size)
        stage.mesh("clearance", rod, "#FFFFFF", flat=True)

    def show(self, frames: Frames, k: int) -> None:
        """Place and colour the rod as in frame k: red at the paper's d_safe, blue from 100 mm on."""
        sms = frames.sms
        pin.framesForwardKinematics(sms.model, self._data, frames.q[k])
        values = self._points.values(self._points.at(frames.q[k], 0.0))[:, 0]
        nearest = int(np.argmin(values))
        points = [np.array(self._data.oMi[j].translation) for j in range(2, sms.model.njoints)]
        points.append(np.array(self._data.oMf[sms.frame_id].translation))
        first, second = self._points.first, self._points.second
        if nearest < len(first):
            start, end = points[first[nearest]], points[second[nearest]]
        else:
            start = points[self._points.outside[nearest - len(first)]]
            end = _on_box(sms, self._data, start)
        apart = end - start
        length = float(np.linalg.norm(apart))
        self._stage.place("clearance", start, along_z(apart), (1.0, 1.0, length))
        usage = 1.0 - np.clip((values[nearest] - _SAFE) / (_FREE - _SAFE), 0.0, 1.0)
        self._stage.tint("clearance", usage_colour(float(usage)))


def limit_usage(sms: SpaceManipulator, q: FloatArray, v: FloatArray) -> FloatArray:
    """Share (n,) of each joint's limits that is used, 0 to 1: of position from the middle, or of rate."""
    limits = sms.limits
    bounded = np.isfinite(limits.lower) & np.isfinite(limits.upper)
    lower, upper = np.where(bounded, limits.lower, -1.0), np.where(bounded, limits.upper, 1.0)
    away = np.abs(sms.layout.positions(q) - 0.5 * (lower + upper)) / (0.5 * (upper - lower))
    position = np.where(bounded, away, 0.0)
    rate = np.abs(v[6:]) / limits.velocity
    return np.clip(np.maximum(position, rate), 0.0, 1.0)


def _on_box(sms: SpaceManipulator, data: Any, point: FloatArray) -> FloatArray:
    """The place on the base box that is nearest to a point outside of it."""
    pose = data.oMi[1] * sms.base_box_placement
    half = 0.5 * np.array(sms.base_size)
    return np.asarray(pose.act(np.clip(pose.actInv(point), -half, half)))
