"""Clearances at one configuration, as tests ask for them: a stack of one."""

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
        """What each clearance is between."""
        return self.stack.names

    def values(self, q: FloatArray) -> FloatArray:
        """Clearances (m,) [m]."""
        return self.gradients(q)[0]

    def gradients(self, q: FloatArray, near: FloatArray | float = np.inf) -> tuple[FloatArray, FloatArray]:
        """Clearances (m,) [m] and their gradients (m, n) by the joints; bounds beyond `near`."""
        poses = self.stack.at(q, 0.0)
        where = np.arange(self.count), np.zeros(self.count, dtype=np.intp)
        found = self.stack.nearest(poses, where, near)
        return found.distance, self.stack.slopes(poses, where, found)[0].T


class Points(At):
    """The paper's points."""

    def __init__(self, sms: ffsms.SpaceManipulator) -> None:
        points = PointStack(sms)
        super().__init__(points)
        between = points.ends[:, 1] >= 0
        self.second, self.first = points.ends[between].T
        self.outside = points.ends[~between, 0]


def least_clearance(limit: opt.Clearance, motions: opt.Rollouts) -> tuple[float, str]:
    """The least clearance [m] of motions at their instants, and between what."""
    found = []
    for stack in limit._stacks:
        values = stack.values(stack.along(motions)).min(axis=1)
        found.append((float(values.min()), stack.names[int(np.argmin(values))]))
    return min(found)
