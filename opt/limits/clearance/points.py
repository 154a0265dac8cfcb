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
from ffsms_pin.opt.limits.clearance.distances import Nearest
from ffsms_pin.opt.limits.clearance.poses import Poses
from ffsms_pin.opt.limits.clearance.stack import ClearanceStack
from ffsms_pin.opt.motion.residual import Indices
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.batch.stacks import dot

__all__ = ["PointStack"]

_SAMPLES = 4
_STILL = 1e-9  # [m] what is closer to constant than this is constant
# [m] Clearances of finished motions are looked at twice a step; what they can lose in between is a few
# micrometres.
_BETWEEN = 1e-5
_LEAST = 1e-12  # [m] nearer than this two points have no direction from one to the other


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
        n, arm, box = sms.n, self.arm, sms.base_box_placement
        self._half = 0.5 * np.array(sms.base_size)
        self._rotation, self._centre = box.rotation.copy(), box.translation.copy()
        # Bodies that carry the points.
        self._carriers = np.append(np.arange(n), arm.last)
        rng = np.random.default_rng(0)
        cloud = self._points(Poses.at(arm, rng.uniform(-1.0, 1.0, (_SAMPLES, n)).T)).transpose(2, 1, 0)
        apart = np.linalg.norm(cloud[:, :, None] - cloud[:, None], axis=-1)
        self.first, self.second = np.nonzero(np.triu(np.ptp(apart, axis=0) > _STILL, 1))
        self.outside = np.flatnonzero(np.ptp(cloud, axis=0).max(axis=1) > _STILL)
        # What is apart from a point: another point, or the base.
        self._ends = np.concatenate([self.first, self.outside])
        behind = np.concatenate([self._carriers[self.second], np.full(len(self.outside), -1)])
        self.bodies = np.stack([behind, self._carriers[self._ends]], axis=1)
        self.carried = np.vstack([arm.carries.T, np.zeros((1, n))])
        # For the kernel: ends, what they are apart from (-1: the box), and the joints that carry each.
        apart = np.concatenate([self.second, np.full(len(self.outside), -1)])
        carried = (self.carried[self.bodies[:, i]] for i in (1, 0))
        box = np.vstack([self._rotation, self._centre, self._half])
        self._pairs = (self._ends.astype(np.int64), apart.astype(np.int64), *carried, box)
        points = [*sms.joint_names, sms.end_effector]
        self.names = [f"{points[i]} - {points[j]}" for i, j in zip(self.first, self.second, strict=True)]
        self.names += [f"{points[i]} - base box" for i in self.outside]
        self.largest = np.full(len(self.names), np.inf)

    def __reduce__(self) -> tuple[Any, ...]:
        return PointStack, (self.sms,)

    def nearest(self, poses: Poses, where: tuple[Indices, ...], near: FloatArray | float = np.inf) -> Nearest:
        """As `ClearanceStack.nearest`: pairs of points, and how far points are outside the box."""
        (columns, at), pairs = where, len(self.first)
        points = self._points(poses)
        there, here = points[:, self._ends[columns], at], np.zeros((3, len(columns)))
        value, normal = np.empty(len(columns)), np.empty((3, len(columns)))
        between, boxed = np.flatnonzero(columns < pairs), np.flatnonzero(columns >= pairs)
        here[:, between] = points[:, self.second[columns[between]], at[between]]
        apart = there[:, between] - here[:, between]
        value[between] = length = np.sqrt(dot(apart, apart))
        normal[:, between] = apart / np.maximum(length, _LEAST)
        # Outside the box: beyond the face that the point is furthest beyond.
        place = np.einsum("xi,xv->iv", self._rotation, there[:, boxed] - self._centre[:, None])
        beyond = np.abs(place) - self._half[:, None]
        axis = beyond.argmax(axis=0)
        value[boxed] = beyond.max(axis=0, initial=-np.inf)
        sign = np.where(np.take_along_axis(place, axis[None], axis=0) < 0.0, -1.0, 1.0)
        normal[:, boxed] = sign * self._rotation[:, axis]
        return Nearest(value, here, there, normal)

    def now(self, joints: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distances (m,) and their gradients (m, n) at joint positions (n,)."""
        return kernel.point_clearances(self.arm.tree, joints, *self._pairs)

    def _points(self, poses: Poses) -> FloatArray:
        """The points (3, n + 1, B), base axes."""
        tip = np.einsum("xyb,y->xb", poses.rotations[:, :, self.arm.last], self.arm.tip_in_last)
        tip += poses.origins[:, self.arm.last]
        return np.concatenate([poses.origins[:, : self.sms.n], tip[:, None]], axis=1)
