"""Measure distances to obstacles by Coal alone, for tests; START and GOAL are a motion of the planar arm."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np
import pinocchio as pin

import ffsms_pin as ffsms
from ffsms_pin.checks import FloatArray

__all__ = ["GOAL", "START", "ByCoal"]

START = np.radians([23.0, 40.0, -29.0])
GOAL = [0.45, 0.75, 0.0]


class ByCoal:
    """The smallest distance of the robot's collision shapes to a shape in inertial space, by Coal alone."""

    def __init__(self, sms: ffsms.SpaceManipulator) -> None:
        self._model, self._data = sms.model, sms.model.createData()
        self._geometry = sms.geometry("collision")
        self._placed = self._geometry.createData()

    def __call__(self, q: FloatArray, shape: Any, pose: pin.SE3, bodies: list[int] | None = None) -> float:
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._placed, q)
        least, there = np.inf, coal.Transform3s(pose.rotation, pose.translation)
        for item, place in zip(self._geometry.geometryObjects, self._placed.oMg, strict=True):
            if bodies is None or int(item.parentJoint) in bodies:
                here = coal.Transform3s(place.rotation, place.translation)
                result = coal.DistanceResult()
                distance = coal.distance(item.geometry, here, shape, there, coal.DistanceRequest(), result)
                least = min(least, distance)
        return float(least)
