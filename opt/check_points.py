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
from ffsms_pin.opt.clearances import Clearances
from ffsms_pin.system import SpaceManipulator

__all__ = ["CheckPoints"]

_SAMPLES = 4
_NEXT, _AFTER = [1, 2, 0], [2, 0, 1]  # columns of a cross product
_STILL = 1e-9  # [m] what is closer to constant than this is constant


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
        carriers = [*self._joints, self._frame_joint]
        # Which joints move which point; a joint leaves its own origin where it is unless it slides.
        self._moved_by = np.zeros((len(carriers), sms.n))
        for row, carrier in enumerate(carriers):
            for joint in list(sms.model.supports[carrier])[2:]:
                self._moved_by[row, sms.model.joints[joint].idx_v - 6] = 1.0
        self._first, self._second, self._outside = self._what_can_change()
        self._rows = np.array([*self._first, *self._second, *self._outside], dtype=np.intp)
        self._moves = self._moved_by[self._rows]

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

    def evaluate(self, q: FloatArray) -> Clearances:
        """Clearances and gradients at q (nq,): pairs of points, then distances outside the base box."""
        sms = self._sms
        pin.computeJointJacobians(sms.model, sms._data, q)
        pin.updateFramePlacement(sms.model, sms._data, sms.frame_id)
        return self.from_data(sms._data)

    def from_data(self, data: Any) -> Clearances:
        """The same, where Pinocchio's data already hold poses, Jacobians and the end-effector frame."""
        points = self._points(data)
        value = np.empty(self.count)
        pairs = len(self._first)
        apart = points[self._first] - points[self._second]
        distance = np.sqrt(np.einsum("ij,ij->i", apart, apart))
        unit = apart / np.maximum(distance, 1e-12)[:, None]
        value[:pairs] = distance
        box = data.oMi[1] * self._box
        rotation = box.rotation
        value[pairs:], normal = self._outside_box((points[self._outside] - box.translation) @ rotation)

        # Speed of a point p along a direction u a joint rate, base held still: (l + a x p) . u, which is
        # l . u + a . (p x u) for a joint of linear and angular columns l and a. One row a point and
        # direction: the pairs' first points, their second points the other way, those outside the box.
        along = np.concatenate([unit, -unit, normal @ rotation.T])
        arm = points[self._rows]
        turning = arm[:, _NEXT] * along[:, _AFTER] - arm[:, _AFTER] * along[:, _NEXT]
        J = data.J
        speed = (along @ J[:3, 6:] + turning @ J[3:, 6:]) * self._moves
        gradient = np.concatenate([speed[:pairs] + speed[pairs : 2 * pairs], speed[2 * pairs :]])
        return Clearances(value, gradient)

    def values(self, data: Any) -> FloatArray:
        """Clearances alone, from data that hold poses and the end-effector frame."""
        points = self._points(data)
        apart = points[self._first] - points[self._second]
        box = data.oMi[1] * self._box
        place = (points[self._outside] - box.translation) @ box.rotation
        return np.concatenate([np.sqrt(np.einsum("ij,ij->i", apart, apart)), self._outside_box(place)[0]])

    def _points(self, data: Any) -> FloatArray:
        points = [data.oMi[j].translation for j in self._joints]
        points.append(data.oMf[self._sms.frame_id].translation)
        return np.array(points)

    def _outside_box(self, place: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance to the box in the largest-component sense of const5 to const7, and its outward normal."""
        beyond = np.abs(place) - self._half
        axis = np.argmax(beyond, axis=1)
        rows = np.arange(len(place))
        normal = np.zeros_like(place)
        normal[rows, axis] = np.where(place[rows, axis] < 0.0, -1.0, 1.0)
        return beyond[rows, axis], normal

    def _what_can_change(self) -> tuple[list[int], list[int], list[int]]:
        sms = self._sms
        data = sms.model.createData()
        rng = np.random.default_rng(0)
        clouds = []
        for _ in range(_SAMPLES):
            q = sms.configuration(rng.uniform(-1.0, 1.0, sms.n))
            pin.framesForwardKinematics(sms.model, data, q)
            rotation, origin = data.oMi[1].rotation, data.oMi[1].translation
            clouds.append((self._points(data) - origin) @ rotation)
        cloud = np.array(clouds)
        apart = np.linalg.norm(cloud[:, :, None] - cloud[:, None], axis=-1)
        changing = np.ptp(apart, axis=0) > _STILL
        first, second = np.nonzero(np.triu(changing, 1))
        outside = np.flatnonzero(np.ptp(cloud, axis=0).max(axis=1) > _STILL)
        return first.tolist(), second.tolist(), outside.tolist()
