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

__all__ = ["Points"]

_SAMPLES = 4
_STILL = 1e-9  # [m] what is closer to constant than this is constant
_LEAST = 1e-12  # [m] nearer than this two points have no direction from one to the other
# (places @ _CROSS).reshape(-1, 3, 3) are the matrices [p]x, with [p]x a = p x a.
_CROSS = np.zeros((3, 3, 3))
_CROSS[0, 2, 1] = _CROSS[1, 0, 2] = _CROSS[2, 1, 0] = 1.0
_CROSS[0, 1, 2] = _CROSS[1, 2, 0] = _CROSS[2, 0, 1] = -1.0
_CROSS = _CROSS.reshape(3, 9)


class Points:
    """The points d_i of the paper: every joint's origin, and the end effector.

    A pair of points counts where its distance can change (adjacent joints are a link's length apart for
    ever), and a point counts against the box where it moves relative to the base (the paper's i >= 2).
    Read literally, const5 to const7 would ask all three to hold at once; their sense is that a point is
    outside the box, so one of them must, in base axes.

    It has Pinocchio's scratch data of its own, and so is for one thread.

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
        self._sms, self._data = sms, model.createData()
        self._joints = list(range(2, model.njoints))
        self._half = 0.5 * np.array(sms.base_size)
        self._box: Any = sms.base_box_placement
        self.first, self.second, self.outside = self._what_can_change()
        # Which joints carry which points. A joint leaves its own origin where it is unless it slides.
        self._carried = np.zeros((len(self._joints) + 1, 1, sms.n))
        for point, carrier in enumerate([*self._joints, model.frames[sms.frame_id].parentJoint]):
            for joint in list(model.supports[carrier])[2:]:
                self._carried[point, 0, model.joints[joint].idx_v - 6] = 1.0

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
        pin.forwardKinematics(self._sms.model, self._data, q)
        places = self._places()
        apart = places[self.first] - places[self.second]
        return np.concatenate([np.sqrt((apart * apart).sum(1)), self._beyond(places).max(1)])

    def gradients(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Clearances (m,) [m] and their gradients (m, n) by the joints [m/rad] at q (nq,)."""
        J = pin.computeJointJacobians(self._sms.model, self._data, q)
        places = self._places()
        # Velocity of a point p that a joint of columns l, a carries, base held still: l + a x p.
        velocities = (J[:3, 6:] - (places @ _CROSS).reshape(-1, 3, 3) @ J[3:, 6:]) * self._carried

        apart = places[self.first] - places[self.second]
        distances = np.sqrt((apart * apart).sum(1))
        along = apart / np.maximum(distances, _LEAST)[:, None]
        pairs = along[:, None] @ (velocities[self.first] - velocities[self.second])

        beyond = self._beyond(places)
        face = beyond.argmax(1)
        normals = self._normals()[face]
        box = normals[:, None] @ velocities[self.outside]
        value = np.concatenate([distances, beyond.max(1)])
        return value, np.concatenate([pairs, box])[:, 0]

    def _places(self) -> FloatArray:
        """Points (k, 3), inertial axes, from poses in the data."""
        tip = pin.updateFramePlacement(self._sms.model, self._data, self._sms.frame_id)
        poses = self._data.oMi
        return np.array([*(poses[j].translation for j in self._joints), tip.translation])

    def _normals(self) -> FloatArray:
        """Outward normals (6, 3) of the box's faces x, y, z, -x, -y, -z, inertial axes."""
        axes = (self._data.oMi[1].rotation @ self._box.rotation).T
        return np.concatenate([axes, -axes])

    def _beyond(self, places: FloatArray) -> FloatArray:
        """How far the points that count against the box are beyond each of its faces."""
        normals = self._normals()
        centre = self._data.oMi[1].act(self._box.translation)
        beyond: FloatArray = (places[self.outside] - centre) @ normals.T - np.tile(self._half, 2)
        return beyond

    def _what_can_change(self) -> tuple[Any, Any, Any]:
        """Pairs of points whose distance can change, and points that can move in base axes."""
        sms = self._sms
        rng, clouds = np.random.default_rng(0), []
        for _ in range(_SAMPLES):
            q = sms.configuration(rng.uniform(-1.0, 1.0, sms.n))
            pin.forwardKinematics(sms.model, self._data, q)
            root = self._data.oMi[1]
            clouds.append((self._places() - root.translation) @ root.rotation)
        cloud = np.array(clouds)
        apart = np.linalg.norm(cloud[:, :, None] - cloud[:, None], axis=-1)
        first, second = np.nonzero(np.triu(np.ptp(apart, axis=0) > _STILL, 1))
        return first, second, np.flatnonzero(np.ptp(cloud, axis=0).max(axis=1) > _STILL)
