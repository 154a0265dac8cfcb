"""Where a scene can be looked at from, and how it moves under a camera that rides on the base."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray, one_of
from ffsms_pin.viewer.frames import Frames

__all__ = ["CAMERAS", "FREE", "ON_BASE", "camera_facts", "camera_place", "checked_camera", "riding"]

FREE, ON_BASE = "free", "base"

# Direction to the camera from what it sees, inertial axes, by name; those of None are found for each scene.
CAMERAS: Mapping[str, tuple[float, float, float] | None] = {
    FREE: None,
    "front": (1.0, 0.0, 0.0),
    "side": (0.0, -1.0, 0.0),
    "top": (0.0, -1e-3, 1.0),
    ON_BASE: None,
}

# Distance of a camera in radii of what it should see. From 1.64 on it sees all of it in the worst case, which
# directions along an axis come near to.
_FREE_DISTANCE, _DISTANCE = 1.3, 1.65
_FLAT = 1e-6  # [m] a motion that spreads less along z is planar, and best seen from above
_ABOVE, _OBLIQUE = (-0.12, -0.75, 1.5), (1.0, -1.5, 0.95)


def checked_camera(name: str) -> str:
    """The name of a camera; `InvalidValue` for others."""
    return one_of("camera", name, tuple(CAMERAS))


def camera_place(name: str, frames: Frames, radius: float) -> FloatArray:
    """Where a camera is, from the middle of what it sees (3,) [m]; its radius is `radius` [m].

    The free one looks at a planar motion from above.
    """
    along, distance = CAMERAS[name], _DISTANCE
    if along is None:
        along = _ABOVE if np.ptp(frames.tips[:, 2]) < _FLAT else _OBLIQUE
        distance = _FREE_DISTANCE
    return np.asarray(distance * radius * np.array(along) / np.linalg.norm(along))


def camera_facts(frames: Frames, camera: str, radius: float, centre: FloatArray) -> dict[str, Any]:
    """What the page must know of the cameras.

    Parameters
    ----------
    frames : Frames
    camera : str
        The first one.
    radius : float
        Of what they see [m].
    centre : ndarray, shape (3,)
        What they turn about [m].
    """
    places = {name: camera_place(name, frames, radius) for name in CAMERAS}
    return {
        "camera": camera,
        "centre": [round(float(x), 5) for x in centre],
        "cameras": {name: [round(float(x), 5) for x in place] for name, place in places.items()},
        "riding": riding(frames, centre),
    }


def riding(frames: Frames, centre: FloatArray) -> list[list[float]]:
    """Poses of the scene, frame by frame, under which the base stays where it is at first.

    Parameters
    ----------
    frames : Frames
    centre : ndarray, shape (3,)
        What the camera turns about [m].

    Returns
    -------
    list of list
        Position [m] and quaternion (x, y, z, w) of the scene's root, 7 numbers a frame.
    """
    first = pin.SE3(np.eye(3), -centre) * pin.XYZQUATToSE3(frames.q[0, :7])
    poses = [first * pin.XYZQUATToSE3(q[:7]).inverse() for q in frames.q]
    rows = np.array([pin.SE3ToXYZQUAT(pose) for pose in poses])
    for k in range(1, len(rows)):  # q and -q are one attitude: neighbours take the same sign
        if rows[k, 3:] @ rows[k - 1, 3:] < 0.0:
            rows[k, 3:] *= -1.0
    return [[round(float(value), 5) for value in row] for row in rows]
