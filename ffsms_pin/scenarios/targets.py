"""The goals that a scenario file describes: the target, goals of other frames, and waypoints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt import Also, Goal, Moving, Pose, Position, Via
from ffsms_pin.scenarios.keys import radians
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.mechanism import frame_index

__all__ = ["Straight", "goal_of", "other_goals", "waypoints"]


@dataclass(frozen=True, eq=False)
class Straight:
    """A place that moves at a constant velocity and turns at a constant rate, inertial axes.

    Attributes
    ----------
    position : ndarray, shape (3,)
        At the start [m].
    velocity : ndarray, shape (3,)
        [m/s]
    rotation : ndarray, shape (3, 3), or None
        Attitude at the start; None where any will do.
    spin : ndarray, shape (3,)
        Angular velocity [rad/s].
    """

    position: FloatArray
    velocity: FloatArray
    rotation: FloatArray | None
    spin: FloatArray

    def __call__(self, t: float) -> Any:
        """The position (3,) [m] or the pose (pinocchio.SE3) at a time [s]."""
        place = self.position + t * self.velocity
        if self.rotation is None:
            return place
        return pin.SE3(pin.exp3(t * self.spin) @ self.rotation, place)


def goal_of(target: Mapping[str, Any], sms: SpaceManipulator, q0: FloatArray) -> Goal:
    """The goal that the table [target] describes, for a start q0 (nq,)."""
    values = radians(target)
    axes = _axes(values, sms, q0, sms.end_effector)
    place = _place(values, axes)
    reaches = {key: values[key] for key in ("tolerance", "orientation_reach") if key in values}

    def vector(key: str) -> FloatArray:
        return np.asarray(axes.rotation @ np.array(values.get(key, (0.0, 0.0, 0.0))))

    turned = isinstance(place, pin.SE3)
    velocity, spin = vector("velocity"), vector("spin")
    if velocity.any() or spin.any():
        path = Straight(
            place.translation if turned else place, velocity, place.rotation if turned else None, spin
        )
        return Moving(path, **reaches)
    arrives = "arrival_velocity" in values
    if turned:
        twist = np.concatenate([vector("arrival_velocity"), vector("arrival_spin")]) if arrives else None
        return Pose(place, twist, **reaches)
    return Position(place, vector("arrival_velocity") if arrives else None, **reaches)


def other_goals(rows: tuple[Mapping[str, Any], ...], sms: SpaceManipulator, q0: FloatArray) -> list[Also]:
    """The goals of other frames that the tables [[also]] describe."""
    found = []
    for row in rows:
        values = radians(row)
        reaches = {key: values[key] for key in ("tolerance", "reach", "orientation_reach") if key in values}
        place = _place(values, _axes(values, sms, q0, values["frame"]))
        goal = Pose(place, **reaches) if isinstance(place, pin.SE3) else Position(place, **reaches)
        found.append(Also(values["frame"], goal))
    return found


def waypoints(rows: tuple[Mapping[str, Any], ...], sms: SpaceManipulator, q0: FloatArray) -> list[Via]:
    """The waypoints that the tables [[via]] describe; they are numbered where they have no name."""
    found = []
    for i, row in enumerate(rows, start=1):
        values = radians(row)
        others = {key: values[key] for key in ("time", "reach", "orientation_reach") if key in values}
        place = _place(values, _axes(values, sms, q0, sms.end_effector))
        found.append(Via(place, name=values.get("name", f"via {i}"), **others))
    return found


def _place(values: Mapping[str, Any], axes: Any) -> Any:
    """A position (3,) or a pose (pinocchio.SE3) in inertial axes."""
    position = np.array(values["position"])
    if "rpy" not in values:
        return np.asarray(axes.act(position))
    return axes * pin.SE3(pin.rpy.rpyToMatrix(np.array(values["rpy"])), position)


def _axes(values: Mapping[str, Any], sms: SpaceManipulator, q0: FloatArray, frame: str) -> Any:
    """The pose (pinocchio.SE3) in whose axes a place is given: those at the start, which do not move."""
    which = values.get("relative_to", "inertial")
    if which == "inertial":
        return pin.SE3.Identity()
    if which == "base":
        return pin.XYZQUATToSE3(np.asarray(q0[:7]))
    data = sms.model.createData()
    pin.forwardKinematics(sms.model, data, q0)
    return pin.updateFramePlacement(sms.model, data, frame_index(sms.model, frame)).copy()
