"""The paper's collision constraints on points: link to link (const4), arm to base box (const5 to const7).

All of them depend on the joints alone: distances between points, and places in base axes, do not change when
the base moves. So their gradients are those of the arm on a fixed base.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.clearances import Clearances
from ffsms_pin.opt.joint_reach import joint_reach
from ffsms_pin.system import SpaceManipulator

__all__ = ["CheckPoints"]

_SAMPLES = 4
_NEXT, _AFTER = [1, 2, 0], [2, 0, 1]  # columns of a cross product
_STILL = 1e-9  # [m] what is closer to constant than this is constant
_LEAST = 1e-12  # [m] nearer than this two points have no direction from one to the other


class CheckPoints:
    """The points d_i of the paper: every joint's origin, and the end effector.

    A pair of points counts where its distance can change (adjacent joints are a link's length apart for
    ever), and a point counts against the box where it moves relative to the base (the paper's i >= 2).
    Read literally, const5 to const7 would ask all three to hold at once; their sense is that a point is
    outside the box, so one of them must, in base axes.

    Parameters
    ----------
    sms : SpaceManipulator
        Its base must have a box (`base_size`).
    """

    def __init__(self, sms: SpaceManipulator) -> None:
        if sms.base_size is None:
            raise InvalidValue(
                "base_size", None, "is needed to keep the arm out of the base: load(..., base_size=(l, w, h))"
            )
        self._sms = sms
        self._half = 0.5 * np.array(sms.base_size)
        self._box: Any = sms.base_box_placement
        self._frame_joint = int(sms.model.frames[sms.frame_id].parentJoint)
        self._joints = list(range(2, sms.model.njoints))
        self._first, self._second, self._outside = self._what_can_change()
        self._allocate()

    def _allocate(self) -> None:
        """Constant matrices, and arrays that `from_data` uses again and again."""
        sms, pairs, rows = self._sms, len(self._first), self.count
        n, points = sms.n, len(self._joints) + 1
        # From the points, and the root's origin below them, to a vector for each clearance: from the second
        # point of a pair to its first, from the root to a point. And to the first point alone.
        ahead = [*self._first, *self._outside]
        behind = [*self._second, *([points] * len(self._outside))]
        select = np.eye(points + 1)
        self._select = np.vstack([select[ahead] - select[behind], select[ahead]])
        # A joint moves a clearance where it carries one of the two points and not the other; it leaves its
        # own origin where it is unless it slides.
        carries = np.zeros((points + 1, n))
        for row, carrier in enumerate([*self._joints, self._frame_joint]):
            for joint in list(sms.model.supports[carrier])[2:]:
                carries[row, sms.model.joints[joint].idx_v - 6] = 1.0
        self._moves = carries[ahead] - carries[behind]
        # A cross product p x u is a difference of products of turned-round coordinates.
        nxt, after = np.eye(3)[:, _NEXT], np.eye(3)[:, _AFTER]
        self._of_point, self._of_direction = np.hstack([nxt, after]), np.hstack([after, nxt])
        self._twice = np.vstack([np.eye(3), -np.eye(3)])
        # Outward normals of the faces x, -x, y, -y, z, -z of the box, and where the faces are along them.
        axes = self._box.rotation.T
        self._faces = np.array([axes[0], -axes[0], axes[1], -axes[1], axes[2], -axes[2]])
        places = self._faces @ self._box.translation + np.repeat(self._half, 2)
        self._places_of_faces = np.tile(places, (len(self._outside), 1))

        self._places = np.empty((points + 1, 3))
        self._flat = self._places.reshape(-1)
        self._vectors = np.empty((2 * rows, 3))
        self._apart, self._from_root = self._vectors[:pairs], self._vectors[pairs:rows]
        self._ahead = self._vectors[rows:]
        self._squares, self._distances = np.empty((pairs, 3)), np.empty((pairs, 3))
        self._sum, self._least = np.ones((3, 3)), np.full((pairs, 3), _LEAST)
        self._normals = np.empty((6, 3))
        self._beyond = np.empty((len(self._outside), 6))
        self._row_starts = np.arange(0, 6 * len(self._outside), 6)
        self._along, self._products = np.empty((rows, 3)), np.empty((rows, 6))
        self._along_pairs, self._along_outside = self._along[:pairs], self._along[pairs:]
        self._work = sms.model.createData()
        self._look_at(self._work)

    def __reduce__(self) -> tuple[Any, ...]:
        # Copied one by one, arrays would no longer be views of each other: a copy makes its own.
        return CheckPoints, (self._sms,)

    @property
    def count(self) -> int:
        """Number of clearances."""
        return len(self._first) + len(self._outside)

    @property
    def pairs(self) -> tuple[list[int], list[int]]:
        """First and second points of the pairs that count: joint origins, then the end effector."""
        return self._first, self._second

    @property
    def outside(self) -> list[int]:
        """Points that count against the base box."""
        return self._outside

    def names(self) -> list[str]:
        """What each clearance is between, in order."""
        points = [*self._sms.joint_names, self._sms.end_effector]
        pairs = [f"{points[i]} - {points[j]}" for i, j in zip(self._first, self._second, strict=True)]
        return pairs + [f"{points[i]} - base box" for i in self._outside]

    def reach(self) -> FloatArray:
        """Bounds (m, n) on the sizes of the gradients at any q [m/rad]."""
        sms = self._sms
        tip = float(np.linalg.norm(sms.model.frames[sms.frame_id].placement.translation))
        carriers = [*((joint, 0.0) for joint in self._joints), (self._frame_joint, tip)]
        of_points = np.array([*(joint_reach(sms.model, *carrier) for carrier in carriers), np.zeros(sms.n)])
        behind = [*self._second, *([len(carriers)] * len(self._outside))]
        # Of the two points of a pair a joint that matters carries one.
        either = np.maximum(of_points[[*self._first, *self._outside]], of_points[behind])
        return np.where(self._moves != 0.0, either, 0.0)

    def evaluate(self, q: FloatArray) -> Clearances:
        """Clearances and gradients at q (nq,): pairs of points, then distances outside the base box."""
        sms, data = self._sms, self._work
        pin.computeJointJacobians(sms.model, data, q)
        pin.updateFramePlacement(sms.model, data, sms.frame_id)
        return self.from_data(data)

    def from_data(self, data: Any) -> Clearances:
        """The same, where Pinocchio's data already hold poses, Jacobians and the end-effector frame."""
        value, face = self._measure(data)
        along = self._along
        np.maximum(self._distances, self._least, out=self._distances)
        np.divide(self._apart, self._distances, self._along_pairs)
        self._normals.take(face, 0, self._along_outside, "clip")
        # Speed of a point p along a direction u a joint rate, base held still: (l + a x p) . u, which is
        # l . u + a . (p x u) for a joint of linear and angular columns l and a. Both points of a pair give
        # the same, since they are apart along u: what counts is which of them a joint carries.
        np.multiply(self._ahead.dot(self._of_point), along.dot(self._of_direction), self._products)
        gradient = along.dot(self._linear)
        gradient += self._products.dot(self._twice.dot(self._angular))
        gradient *= self._moves
        return Clearances(value, gradient)

    def values(self, data: Any) -> FloatArray:
        """Clearances alone, from data that hold poses and the end-effector frame."""
        return self._measure(data)[0]

    def _measure(self, data: Any) -> tuple[FloatArray, NDArray[np.intp]]:
        """Clearances, and the nearest face of the box for the points that count against it."""
        if data is not self._data:  # others were looked at last
            self._look_at(data)
        value, pairs = np.empty(self.count), len(self._first)
        np.concatenate(self._origins, out=self._flat)
        self._select.dot(self._places, self._vectors)
        # Every column of the matrix of ones sums the squares: the distance three times, to divide by.
        np.multiply(self._apart, self._apart, self._squares)
        np.sqrt(self._squares.dot(self._sum, self._distances), self._distances)
        value[:pairs] = self._distances[:, 0]
        # Outside the box in the largest-component sense of const5 to const7.
        self._faces.dot(self._rotation.T, self._normals)
        beyond = self._from_root.dot(self._normals.T, self._beyond)
        beyond -= self._places_of_faces
        face = beyond.argmax(1)
        value[pairs:] = beyond.take(face + self._row_starts)
        return value, face

    def _look_at(self, data: Any) -> None:
        """Keep views of what is needed of the data: Pinocchio makes new objects at every access."""
        poses = [*(data.oMi[j] for j in self._joints), data.oMf[self._sms.frame_id], data.oMi[1]]
        self._origins, self._rotation, J = _views(
            lambda: ([pose.translation for pose in poses], data.oMi[1].rotation, data.J)
        )
        self._linear, self._angular = J[:3, 6:], J[3:, 6:]
        self._data = data

    def _what_can_change(self) -> tuple[list[int], list[int], list[int]]:
        sms = self._sms
        data = sms.model.createData()
        rng = np.random.default_rng(0)
        clouds = []
        for _ in range(_SAMPLES):
            q = sms.configuration(rng.uniform(-1.0, 1.0, sms.n))
            pin.framesForwardKinematics(sms.model, data, q)
            rotation, origin = data.oMi[1].rotation, data.oMi[1].translation
            points = [data.oMi[j].translation for j in self._joints] + [data.oMf[sms.frame_id].translation]
            clouds.append((np.array(points) - origin) @ rotation)
        cloud = np.array(clouds)
        apart = np.linalg.norm(cloud[:, :, None] - cloud[:, None], axis=-1)
        changing = np.ptp(apart, axis=0) > _STILL
        first, second = np.nonzero(np.triu(changing, 1))
        outside = np.flatnonzero(np.ptp(cloud, axis=0).max(axis=1) > _STILL)
        return first.tolist(), second.tolist(), outside.tolist()


def _views(ask: Callable[[], Any]) -> Any:
    """What Pinocchio gives, as views of its memory even where it was told to give copies."""
    before = pin.sharedMemory()
    pin.sharedMemory(True)
    try:
        return ask()
    finally:
        pin.sharedMemory(before)
