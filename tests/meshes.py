"""Draw joint positions, and measure distances of meshes by Pinocchio and Coal alone, for tests."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

import ffsms_pin as ffsms
from ffsms_pin.checks import FloatArray

__all__ = ["ARMS", "Meshes", "random_joints"]

ARMS = ["satellite_panda", "satellite_ur10"]


def random_joints(sms: ffsms.SpaceManipulator, count: int, seed: int) -> FloatArray:
    """Draw joint positions (n, count) within the limits."""
    rng, limits = np.random.default_rng(seed), sms.limits
    low, high = np.maximum(limits.lower, -np.pi), np.minimum(limits.upper, np.pi)
    drawn: FloatArray = rng.uniform(low, high, (count, sms.n)).T
    return drawn


class Meshes:
    """The distances of a robot's meshes, by Pinocchio and Coal alone."""

    def __init__(self, sms: ffsms.SpaceManipulator) -> None:
        self.sms, self.data = sms, sms.model.createData()
        self.geometry = sms.geometry("collision").copy()
        self.geometry.removeAllCollisionPairs()
        self.of: dict[str, list[int]] = {}
        shapes, parents = self.geometry.geometryObjects, sms.model.parents
        for i, first in enumerate(shapes):
            for j, second in enumerate(shapes):
                a, b = int(first.parentJoint), int(second.parentJoint)
                if a < b and int(parents[b]) != a:
                    body = sms.layout.body_name
                    name = f"{body(sms.model, a)} - {body(sms.model, b)}"
                    self.of.setdefault(name, []).append(len(self.geometry.collisionPairs))
                    self.geometry.addCollisionPair(pin.CollisionPair(i, j))
        self.placed = self.geometry.createData()

    def distances(self, q: FloatArray, names: list[str]) -> FloatArray:
        pin.updateGeometryPlacements(self.sms.model, self.data, self.geometry, self.placed, q)
        pin.computeDistances(self.geometry, self.placed)
        distances_of_pairs = [result.min_distance for result in self.placed.distanceResults]
        return np.array([min(distances_of_pairs[k] for k in self.of[name]) for name in names])

    def collide(self, q: FloatArray) -> bool:
        return bool(pin.computeCollisions(self.sms.model, self.data, self.geometry, self.placed, q, True))
