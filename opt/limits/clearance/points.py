"""The paper's collision constraints on points: link to link (const4), arm to base box (const5 to const7).

All of them depend on the joints alone: distances between points, and places in base axes, do not change when
the base moves. So their gradients are those of the arm on a fixed base.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.limits.clearance.distances import Entries, Nearest, Poses
from ffsms_pin.opt.limits.clearance.stack import ClearanceStack
from ffsms_pin.opt.motion.residual import Indices
from ffsms_pin.system import SpaceManipulator

__all__ = ["PointStack"]

_STILL = 1e-9  # [m] what is closer to constant than this is constant
# [m] Clearances of finished motions are looked at twice a step; what they can lose in between is a few
# micrometres.
_BETWEEN = 1e-5


class PointStack(ClearanceStack):
    """The points d_i of the paper: every joint's origin, and the end effector.

    A pair of points counts where its distance can change (adjacent joints are a link's length apart for
    ever), and a point counts against the box where it moves relative to the base (the paper's i >= 2).
    Read literally, const5 to const7 would ask all three to hold at once; their sense is that a point is
    outside the box, so one of them must, in base axes.

    Parameters
    ----------
    sms : SpaceManipulator
        Its base must have a box (`base_size`).

    Attributes
    ----------
    first, second : ndarray of int
        Points of the pairs that count: joint origins in their order, then the end effector.
    outside : ndarray of int
        Points that count against the base box.

    Raises
    ------
    InvalidValue
        The base has no box.
    """

    mode, tolerance = "points", -_BETWEEN

    def __init__(self, sms: SpaceManipulator) -> None:
        if sms.base_size is None:
            raise InvalidValue(
                "base_size", None, "is needed to keep the arm out of the base: load(..., base_size=(l, w, h))"
            )
        super().__init__(sms)
        n, placed = sms.n, sms.base_box_placement
        self._box = np.vstack([placed.rotation, placed.translation, 0.5 * np.array(sms.base_size)])
        # Every point against every other and against the box, in four postures: what does not change is out.
        first, second = np.triu_indices(n + 1, 1)
        ends = [*zip(second, first, strict=True), *((i, -1) for i in range(n + 1))]
        poses = Poses.of(np.random.default_rng(0).uniform(-1.0, 1.0, (n, 4)))
        self._take(np.array(ends, dtype=np.int64))
        found = self.nearest(poses, self.every(poses))
        apart, there = found.distance.reshape(4, -1), found.points[:, 1].reshape(4, -1, 3)
        changes = np.where(self._ends[:, 1] < 0, np.ptp(there, axis=0).max(axis=1), np.ptp(apart, axis=0))
        self._take(self._ends[changes > _STILL])
        between = self._ends[:, 1] >= 0
        self.second, self.first = self._ends[between].T
        self.outside = self._ends[~between, 0]

    def _take(self, ends: Indices) -> None:
        """Points, and what they are apart from: another point, or the box (-1)."""
        points = [*self.sms.joint_names, self.sms.end_effector]
        carriers = np.array([*range(self.sms.n), self.arm.last, -1], dtype=np.int64)
        self._ends, base = ends, np.full(len(ends), -1)
        self.bodies = np.stack([carriers[ends[:, 1]], carriers[ends[:, 0]], base], axis=1)
        self.names = [f"{points[j]} - {points[i]}" if j >= 0 else f"{points[i]} - base box" for i, j in ends]
        self.largest = np.full(len(ends), np.inf)

    def __reduce__(self) -> tuple[Any, ...]:
        return PointStack, (self.sms,)

    def nearest(self, poses: Poses, where: Entries, near: FloatArray | float = np.inf) -> Nearest:
        """As `ClearanceStack.nearest`: pairs of points, and how far points are outside the box."""
        columns, at = where
        found = kernel.near_points(self.arm.tree, poses.joints, columns, at, self._ends, self._box)
        return Nearest(*found)
