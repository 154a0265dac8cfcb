"""The paper's collision constraints on points: link to link (const4), arm to base box (const5 to const7).

All of them depend on the joints alone: distances between points, and places in base axes, do not change when
the base moves. So their gradients are those of the arm on a fixed base.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.batch.stacks import cross_rows, row_lengths

__all__ = ["Points"]

_SAMPLES = 4
_STILL = 1e-9  # [m] what is closer to constant than this is constant
_LEAST = 1e-12  # [m] nearer than this two points have no direction from one to the other


class Points:
    """The points d_i of the paper: every joint's origin, and the end effector.

    A pair of points counts where its distance can change (adjacent joints are a link's length apart for
    ever), and a point counts against the box where it moves relative to the base (the paper's i >= 2).
    Read literally, const5 to const7 would ask all three to hold at once; their sense is that a point is
    outside the box, so one of them must, in base axes.

    Everything is in base axes. It has Pinocchio's scratch data of its own, and so is for one thread.

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

    def __init__(self, sms: SpaceManipulator) -> None:
        if sms.base_size is None:
            raise InvalidValue(
                "base_size", None, "is needed to keep the arm out of the base: load(..., base_size=(l, w, h))"
            )
        model = sms.model
        self._sms, self._data, self._q = sms, model.createData(), pin.neutral(model)
        self._joints = list(range(2, model.njoints))
        # Views of Pinocchio's memory, which stays where it is: they show what the last call has written.
        poses, shared = self._data.oMi, pin.sharedMemory()
        pin.sharedMemory(True)
        tip = self._data.oMf[sms.frame_id].translation
        self._origins = [*(poses[j].translation for j in self._joints), tip, poses[1].translation]
        self._J = self._data.J
        pin.sharedMemory(shared)
        self.first, self.second, self.outside = self._what_can_change()
        # Of each clearance the point whose motion counts, and what it is apart from: a point, or the root.
        points = len(self._joints) + 1
        ahead = np.concatenate([self.first, self.outside])
        behind = np.concatenate([self.second, np.full(len(self.outside), points)])
        # Matrices (m, k + 1) that take these out of all points and the root.
        self._ahead = np.eye(points + 1)[ahead]
        self._apart = self._ahead - np.eye(points + 1)[behind]
        # A joint moves a clearance where it carries one of the two and not the other. It leaves its own
        # origin where it is unless it slides.
        carries = np.zeros((points + 1, sms.n))
        for point, carrier in enumerate([*self._joints, model.frames[sms.frame_id].parentJoint]):
            for joint in list(model.supports[carrier])[2:]:
                carries[point, model.joints[joint].idx_v - 6] = 1.0
        self._moves = self._apart.dot(carries)
        # Outward normals (6, 3) of the box's faces, and where the faces are along them.
        box: Any = sms.base_box_placement
        self._normals = np.concatenate([box.rotation.T, -box.rotation.T])
        self._faces = self._normals @ box.translation + np.tile(0.5 * np.array(sms.base_size), 2)

    def __reduce__(self) -> tuple[Any, ...]:
        return Points, (self._sms,)  # a copy has data of its own

    @property
    def count(self) -> int:
        """Number of clearances, m."""
        return len(self.first) + len(self.outside)

    def names(self) -> list[str]:
        """What each clearance is between, in order."""
        points = [*self._sms.joint_names, self._sms.end_effector]
        pairs = [f"{points[i]} - {points[j]}" for i, j in zip(self.first, self.second, strict=True)]
        return pairs + [f"{points[i]} - base box" for i in self.outside]

    def values(self, q: FloatArray) -> FloatArray:
        """Clearances (m,) at q (nq,): pairs of points, then distances outside the base box [m]."""
        self._q[7:] = q[7:]
        pin.forwardKinematics(self._sms.model, self._data, self._q)
        return self._measure(self._places())[0]

    def least(self, q: FloatArray, below: FloatArray | None = None) -> tuple[FloatArray, Any]:
        """The least of each clearance over configurations, and at which of them: see `ClearanceModel`."""
        values = np.array([self.values(row) for row in q])
        least = values.min(axis=0)
        return least if below is None else np.minimum(least, below), values.argmin(axis=0)

    def gradients(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Clearances (m,) [m] and their gradients (m, n) by the joints [m/rad] at q (nq,)."""
        self._q[7:] = q[7:]
        pin.computeJointJacobians(self._sms.model, self._data, self._q)
        places = self._places()
        value, along = self._measure(places)
        # Speed of a point p along a direction u a joint rate, base held still: (l + a x p) . u, which is
        # l . u + a . (p x u) for a joint of linear and angular columns l and a. Both points of a pair give
        # the same, since they are apart along u: what counts is which of them a joint carries.
        moments = cross_rows(self._ahead.dot(places), along)
        gradient: FloatArray = (along.dot(self._J[:3, 6:]) + moments.dot(self._J[3:, 6:])) * self._moves
        return value, gradient

    def _places(self) -> FloatArray:
        """Points (k + 1, 3), and last the root's origin, from poses in the data."""
        pin.updateFramePlacement(self._sms.model, self._data, self._sms.frame_id)
        return np.concatenate(self._origins).reshape(-1, 3)

    def _measure(self, places: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Clearances (m,), and the unit vectors (m, 3) along which they grow with their first point."""
        apart, pairs = self._apart.dot(places), len(self.first)
        value, along = np.empty(len(apart)), np.empty((len(apart), 3))
        between = apart[:pairs]
        value[:pairs] = row_lengths(between)
        along[:pairs] = between / np.maximum(value[:pairs], _LEAST)[:, None]
        # Outside the box: beyond the face that the point is furthest beyond.
        beyond = apart[pairs:].dot(self._normals.T) - self._faces
        value[pairs:], along[pairs:] = beyond.max(1), self._normals[beyond.argmax(1)]
        return value, along

    def _what_can_change(self) -> tuple[Any, Any, Any]:
        """Pairs of points whose distance can change, and points that can move in base axes."""
        sms = self._sms
        rng, clouds = np.random.default_rng(0), []
        for _ in range(_SAMPLES):
            self._q[7:] = sms.configuration(rng.uniform(-1.0, 1.0, sms.n))[7:]
            pin.forwardKinematics(sms.model, self._data, self._q)
            clouds.append(self._places()[:-1])
        cloud = np.array(clouds)
        apart = np.linalg.norm(cloud[:, :, None] - cloud[:, None], axis=-1)
        first, second = np.nonzero(np.triu(np.ptp(apart, axis=0) > _STILL, 1))
        return first, second, np.flatnonzero(np.ptp(cloud, axis=0).max(axis=1) > _STILL)
