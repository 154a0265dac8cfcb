"""Compute clearances at single configurations, for tests."""

from __future__ import annotations

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.geometry.bodies import PointStack
from ffsms_pin.geometry.distances import ClearanceStack

__all__ = ["At", "Points", "least_clearance"]


class At:
    """A stack of clearances at single configurations q (nq,)."""

    def __init__(self, stack: ClearanceStack) -> None:
        self.stack, self.count = stack, len(stack.names)

    def names(self) -> list[str]:
        """Return the names of the pairs."""
        return self.stack.names

    def values(self, q: FloatArray) -> FloatArray:
        """Return clearances (m,) [m]."""
        return self.gradients(q)[0]

    def gradients(self, q: FloatArray, near: FloatArray | float = np.inf) -> tuple[FloatArray, FloatArray]:
        """Return clearances (m,) [m] and gradients (m, n) by joint positions; lower bounds beyond `near`."""
        poses = self.stack.at(q, 0.0)
        where = np.arange(self.count), np.zeros(self.count, dtype=np.intp)
        nearest = self.stack.nearest(poses, where, near)
        return nearest.distance, self.stack.slopes(poses, where, nearest)[0].T


class Points(At):
    """The clearances of the paper's points."""

    def __init__(self, sms: ffsms.SpaceManipulator) -> None:
        points = PointStack(sms)
        super().__init__(points)
        between = points.ends[:, 1] >= 0
        self.second, self.first = points.ends[between].T
        self.outside = points.ends[~between, 0]


def least_clearance(limit: opt.Clearance, motions: opt.Rollouts) -> tuple[float, str]:
    """Return the smallest clearance [m] of motions, and the name of its pair."""
    smallest = []
    for stack in limit._stacks:
        values = stack.values(stack.along(motions)).min(axis=1)
        smallest.append((float(values.min()), stack.names[int(np.argmin(values))]))
    return min(smallest)
