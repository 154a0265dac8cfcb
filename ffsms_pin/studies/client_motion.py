"""Where a client was in a run: free until it was caught, then with the link that holds it."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray
from ffsms_pin.client import Shape
from ffsms_pin.simulation import Tracking
from ffsms_pin.storage import check_shapes, check_times, load_arrays, save_arrays
from ffsms_pin.studies.capture import Captured, whole_tracking
from ffsms_pin.system import SpaceManipulator

__all__ = ["ClientMotion", "client_motion"]

_FORMAT = "ffsms-pin client 1"
_SHAPES: dict[str, tuple[str | int, ...]] = {
    "t": ("k",),
    "position": ("k", 3),
    "quaternion": ("k", 4),
    "held_from": (),
}


@dataclass(frozen=True, eq=False)
class ClientMotion:
    """Poses of a client's body frame, inertial axes; between the instants it moves straight and turns evenly.

    Attributes
    ----------
    t : ndarray, shape (k,)
        [s]
    position : ndarray, shape (k, 3)
        Of its centre of mass [m].
    quaternion : ndarray, shape (k, 4)
        (x, y, z, w)
    held_from : float
        When the end effector begins to hold it rigidly [s], or closes on nothing.
    shapes : tuple of Shape
        What it looks like.
    """

    t: FloatArray
    position: FloatArray
    quaternion: FloatArray
    held_from: float
    shapes: tuple[Shape, ...] = ()

    def pose(self, t: float) -> Any:
        """The pose (pinocchio.SE3) at a time [s]; before the first instant and after the last one: there."""
        i = int(np.clip(np.searchsorted(self.t, t) - 1, 0, len(self.t) - 2))
        share = float(np.clip((t - self.t[i]) / (self.t[i + 1] - self.t[i]), 0.0, 1.0))
        turn = pin.Quaternion(self.quaternion[i]).slerp(share, pin.Quaternion(self.quaternion[i + 1]))
        place = (1.0 - share) * self.position[i] + share * self.position[i + 1]
        return pin.SE3(turn.toRotationMatrix(), place)

    def poses(self, times: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Positions (K, 3) [m] and attitudes (K, 3, 3) at times (K,) [s]."""
        found = [self.pose(t) for t in np.asarray(times, dtype=np.float64).tolist()]
        return np.array([one.translation for one in found]), np.array([one.rotation for one in found])

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write all but the shapes to an npz file, atomically."""
        save_arrays(path, _FORMAT, {name: getattr(self, name) for name in _SHAPES})

    @classmethod
    def load(cls, path: str | os.PathLike[str], shapes: tuple[Shape, ...] = ()) -> ClientMotion:
        """Read what `save` wrote; a `ResultError` says what is wrong with another file."""
        arrays = load_arrays(
            path, _FORMAT, list(_SHAPES), check=lambda heads: check_shapes(path, heads, _SHAPES)
        )
        check_times(path, arrays["t"], least=2)
        return cls(arrays["t"], arrays["position"], arrays["quaternion"], float(arrays["held_from"]), shapes)


def client_motion(plant: SpaceManipulator, approach: Tracking, capture: Captured) -> ClientMotion:
    """The client's motion in a run that was to capture it.

    Parameters
    ----------
    plant : SpaceManipulator
        What was simulated, without the client.
    approach : Tracking
        Up to the contact.
    capture : Captured
    """
    whole = whole_tracking(approach, capture)
    since = float(whole.t[-1] - capture.tracking.t[-1])
    caught = capture.client if capture.contact is None else capture.contact.client
    then = caught.pose(since if capture.contact is None else 0.0)
    in_hand = plant.at(capture.after.q).end_effector_pose.inverse() * then
    data, frame = plant.model.createData(), plant.frame_id
    positions, quaternions = [], []
    for t, q in zip(whole.t.tolist(), whole.q, strict=True):
        if capture.missed or t < since - 1e-9:
            pose = capture.client.pose(t)
        else:
            pin.forwardKinematics(plant.model, data, q)
            pose = pin.updateFramePlacement(plant.model, data, frame) * in_hand
        positions.append(pose.translation)
        quaternions.append(pin.Quaternion(pose.rotation).coeffs())
    return ClientMotion(
        np.array(whole.t), np.array(positions), np.array(quaternions), since, capture.client.shapes
    )
