"""Exact distances between the collision shapes of the URDF, by coal through Pinocchio's geometry model."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.system import SpaceManipulator

__all__ = ["Shapes"]

_TOUCHING = 1e-9  # [m] nearer than this two points have no direction from one to the other


class Shapes:
    """Distances of every pair of bodies that can meet: all but those that one joint connects.

    The distance of a pair of bodies is that of their nearest shapes. Like the paper's points, distances
    depend on the joints alone; the gradient follows from the velocities of the two nearest points along the
    line between them.

    It has Pinocchio's scratch data of its own, and so is for one thread.

    Parameters
    ----------
    sms : SpaceManipulator
        With collision shapes (`sms.geometry("collision")`).

    Raises
    ------
    InvalidValue
        No two bodies with shapes can meet.
    """

    def __init__(self, sms: SpaceManipulator) -> None:
        model = sms.model
        self._sms, self._data = sms, model.createData()
        self._geometry = sms.geometry("collision").copy()
        self._geometry.removeAllCollisionPairs()
        shapes = self._geometry.geometryObjects
        # Pairs of shapes of each pair of bodies, as indices of Pinocchio's collision pairs.
        self._bodies: dict[tuple[int, int], list[int]] = {}
        for i, first in enumerate(shapes):
            for j in range(i + 1, len(shapes)):
                a, b = sorted((int(first.parentJoint), int(shapes[j].parentJoint)))
                if a != b and int(model.parents[b]) != a:
                    self._bodies.setdefault((a, b), []).append(len(self._geometry.collisionPairs))
                    self._geometry.addCollisionPair(pin.CollisionPair(i, j))
        if not self._bodies:
            raise InvalidValue(
                "the collision shapes", len(shapes), "must give at least one pair of bodies that can meet"
            )
        self._carried = np.zeros((model.njoints, sms.n))
        for joint in range(2, model.njoints):
            for mover in list(model.supports[joint])[2:]:
                self._carried[joint, model.joints[mover].idx_v - 6] = 1.0
        self._placed = self._geometry.createData()

    def __reduce__(self) -> tuple[Any, ...]:
        return Shapes, (self._sms,)  # a copy has data of its own

    @property
    def count(self) -> int:
        """Number of clearances, m: one a pair of bodies."""
        return len(self._bodies)

    def names(self) -> list[str]:
        """What each clearance is between, in order."""
        body, model = self._sms.layout.body_name, self._sms.model
        return [f"{body(model, a)} - {body(model, b)}" for a, b in self._bodies]

    def values(self, q: FloatArray) -> FloatArray:
        """Clearances (m,) at q (nq,) [m], negative where bodies overlap."""
        pin.forwardKinematics(self._sms.model, self._data, q)
        results = self._placed.distanceResults
        return np.array([results[k].min_distance for k in self._nearest()])

    def gradients(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Clearances (m,) [m] and their gradients (m, n) by the joints [m/rad] at q (nq,)."""
        J = pin.computeJointJacobians(self._sms.model, self._data, q)
        value, gradient = np.empty(self.count), np.empty((self.count, self._sms.n))
        for row, k in enumerate(self._nearest()):
            result, pair = self._placed.distanceResults[k], self._geometry.collisionPairs[k]
            here, there, distance = result.getNearestPoint1(), result.getNearestPoint2(), result.min_distance
            # coal leaves its own normal unset for meshes. In an overlap both signs are the other way round.
            normal = (there - here) / distance if abs(distance) > _TOUCHING else np.array(result.normal)
            speed = self._speed(pair.second, there, normal, J) - self._speed(pair.first, here, normal, J)
            value[row], gradient[row] = distance, speed
        return value, gradient

    def _nearest(self) -> list[int]:
        """The pair of shapes that are nearest, for each pair of bodies, from poses in the data."""
        pin.updateGeometryPlacements(self._sms.model, self._data, self._geometry, self._placed)
        pin.computeDistances(self._geometry, self._placed)
        results = self._placed.distanceResults
        return [min(pairs, key=lambda k: results[k].min_distance) for pairs in self._bodies.values()]

    def _speed(self, shape: int, point: FloatArray, normal: FloatArray, J: FloatArray) -> FloatArray:
        """Speeds (n,) of a point of a shape along a direction a joint rate, base held still."""
        joint = int(self._geometry.geometryObjects[shape].parentJoint)
        # (l + a x p) . normal, for a joint of linear and angular columns l and a.
        speed: FloatArray = normal @ J[:3, 6:] + np.cross(point, normal) @ J[3:, 6:]
        speed *= self._carried[joint]
        return speed
