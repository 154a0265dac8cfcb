"""Exact distances between the collision shapes of the URDF, by coal through Pinocchio's geometry model."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.clearances import Clearances
from ffsms_pin.system import SpaceManipulator

__all__ = ["ShapeDistances"]


class ShapeDistances:
    """Distances of every pair of bodies that can meet: all but those that one joint connects.

    The distance of a pair of bodies is that of their nearest shapes. Like the paper's points, distances
    depend on the joints alone; the gradient follows from the velocities of the two nearest points along the
    line between them.

    Parameters
    ----------
    sms : SpaceManipulator
        With collision shapes (`sms.geometry("collision")`).
    """

    def __init__(self, sms: SpaceManipulator) -> None:
        self._sms = sms
        self._geometry = sms.geometry("collision").copy()
        self._geometry.removeAllCollisionPairs()
        shapes = self._geometry.geometryObjects
        bodies: dict[tuple[int, int], list[int]] = {}
        for i, first in enumerate(shapes):
            for j in range(i + 1, len(shapes)):
                a, b = sorted((int(first.parentJoint), int(shapes[j].parentJoint)))
                if a != b and int(sms.model.parents[b]) != a:
                    bodies.setdefault((a, b), []).append(len(self._geometry.collisionPairs))
                    self._geometry.addCollisionPair(pin.CollisionPair(i, j))
        if not bodies:
            raise InvalidValue(
                "the collision shapes", len(shapes), "must give at least one pair of bodies that can meet"
            )
        self._pairs = list(bodies)
        self._members = list(bodies.values())
        self._moved_by = np.zeros((sms.model.njoints, sms.n))
        for joint in range(2, sms.model.njoints):
            for mover in list(sms.model.supports[joint])[2:]:
                self._moved_by[joint, sms.model.joints[mover].idx_v - 6] = 1.0
        self._data = self._geometry.createData()

    @property
    def count(self) -> int:
        """Number of clearances: one a pair of bodies."""
        return len(self._pairs)

    def names(self) -> list[str]:
        """What each clearance is between, in order."""
        bodies = self._sms.layout.body_name
        model = self._sms.model
        return [f"{bodies(model, a)} - {bodies(model, b)}" for a, b in self._pairs]

    def reach(self) -> None:
        """Nothing is known of how fast distances can change."""

    def evaluate(self, q: FloatArray) -> Clearances:
        """Clearances and gradients at q (nq,)."""
        data = self._sms.model.createData()
        pin.computeJointJacobians(self._sms.model, data, q)
        return self.from_data(data)

    def from_data(self, data: Any) -> Clearances:
        """The same, where Pinocchio's data already hold poses and joint Jacobians."""
        nearest = self._nearest(data)
        J = data.J
        linear, angular = J[:3, 6:].T, J[3:, 6:].T  # (n, 3)
        value, gradient = np.empty(self.count), np.empty((self.count, self._sms.n))
        for row, (k, distance) in enumerate(nearest):
            value[row] = distance
            result, pair = self._data.distanceResults[k], self._geometry.collisionPairs[k]
            here, there = result.getNearestPoint1(), result.getNearestPoint2()
            normal = result.normal
            motion = self._motion(pair.second, there, linear, angular)
            motion = motion - self._motion(pair.first, here, linear, angular)
            gradient[row] = motion @ normal
        return Clearances(value, gradient)

    def values(self, data: Any) -> FloatArray:
        """Clearances alone, from data that hold poses."""
        return np.array([distance for _, distance in self._nearest(data)])

    def _nearest(self, data: Any) -> list[tuple[int, float]]:
        pin.updateGeometryPlacements(self._sms.model, data, self._geometry, self._data)
        pin.computeDistances(self._geometry, self._data)
        results = self._data.distanceResults
        best = []
        for members in self._members:
            distances = [results[k].min_distance for k in members]
            least = int(np.argmin(distances))
            best.append((members[least], distances[least]))
        return best

    def _motion(self, shape: int, point: FloatArray, linear: FloatArray, angular: FloatArray) -> FloatArray:
        """Velocity of a point of a shape a joint rate, base held still: (n, 3)."""
        joint = int(self._geometry.geometryObjects[shape].parentJoint)
        motion: FloatArray = (linear + np.cross(angular, point)) * self._moved_by[joint][:, None]
        return motion
