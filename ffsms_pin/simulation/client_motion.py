"""The recorded motion of a client, for viewers and plots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray
from ffsms_pin.client import Shape
from ffsms_pin.errors import InvalidValue
from ffsms_pin.simulation import Tracking


@dataclass(frozen=True, eq=False)
class ClientMotion:
    """The poses of a client's body frame, inertial axes, interpolated between the instants of a recording.

    Attributes
    ----------
    t : ndarray, shape (k,)
        Times [s].
    position : ndarray, shape (k, 3)
        Positions of the client's centre of mass [m].
    quaternion : ndarray, shape (k, 4)
        Attitudes as quaternions (x, y, z, w).
    shapes : tuple of Shape
        The client's shapes with their placements in the body frame.
    """

    t: FloatArray
    position: FloatArray
    quaternion: FloatArray
    shapes: tuple[Shape, ...] = ()

    def pose(self, t: float) -> Any:
        """Return the pose (pinocchio.SE3) at a time [s], clipped to the first and the last instant."""
        if len(self.t) == 1:
            return pin.XYZQUATToSE3(np.concatenate([self.position[0], self.quaternion[0]]))
        i = int(np.clip(np.searchsorted(self.t, t) - 1, 0, len(self.t) - 2))
        share = float(np.clip((t - self.t[i]) / (self.t[i + 1] - self.t[i]), 0.0, 1.0))
        rotation = pin.Quaternion(self.quaternion[i]).slerp(share, pin.Quaternion(self.quaternion[i + 1]))
        position = (1.0 - share) * self.position[i] + share * self.position[i + 1]
        return pin.SE3(rotation.toRotationMatrix(), position)

    def poses(self, times: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return positions (K, 3) [m] and attitudes (K, 3, 3) at times (K,) [s]."""
        poses = [self.pose(t) for t in np.asarray(times, dtype=np.float64).tolist()]
        return np.array([pose.translation for pose in poses]), np.array([pose.rotation for pose in poses])


def client_motion(tracking: Tracking, shapes: tuple[Shape, ...] = ()) -> ClientMotion:
    """Return the client's motion in a recording; `shapes` are the shapes to draw.

    Raises
    ------
    InvalidValue
        The recording has no client.
    """
    poses = tracking.client_pose
    if not poses.shape[1]:
        raise InvalidValue("tracking", tracking, "must be the recording of a run with a client")
    return ClientMotion(tracking.t, poses[:, :3], poses[:, 3:], tuple(shapes))
