"""Key frames for Meshcat's animation: where nodes are, how large, and in what colour, over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
import umsgpack
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray

__all__ = ["Film", "decomposed"]

_FLOAT32 = 0x17  # the extension type under which Meshcat's page reads an array of floats
_STILL = 1e-7


class Film:
    """Tracks of key frames, by the path of the node and the name of its property in three.js."""

    def __init__(self) -> None:
        self._tracks: dict[tuple[str, str, str], tuple[list[float], list[FloatArray]]] = {}

    def key(self, path: str, name: str, kind: str, time: float, value: ArrayLike) -> None:
        """Add one key frame.

        Parameters
        ----------
        path : str
            Of the node.
        name : str
            Property in three.js, such as "position" or "material.color".
        kind : str
            Type of the track in three.js: "vector3", "quaternion", "color", "number".
        time : float
            [s], growing from call to call.
        value : array_like
        """
        times, values = self._tracks.setdefault((path, name, kind), ([], []))
        times.append(time)
        values.append(np.atleast_1d(np.asarray(value, dtype=np.float64)))

    def place(self, path: str, time: float, matrix: FloatArray) -> None:
        """Add key frames of position, attitude and size from a matrix (4, 4)."""
        position, quaternion, scale = decomposed(matrix)
        self.key(path, "position", "vector3", time, position)
        self.key(path, "quaternion", "quaternion", time, quaternion)
        self.key(path, "scale", "vector3", time, scale)

    def lower(self, speed: float) -> list[dict[str, Any]]:
        """Meshcat's form of the animation, one clip a node, `speed` times as fast."""
        clips: dict[str, list[dict[str, Any]]] = {}
        for (path, name, kind), (times, values) in self._tracks.items():
            at, rows = np.array(times) / speed, np.array(values)
            if np.ptp(rows, axis=0).max() <= _STILL:  # two keys say that nothing happens
                at, rows = at[[0, -1]], rows[[0, -1]]
            clips.setdefault(path, []).append(
                {"name": f".{name}", "type": kind, "times": _packed(at), "values": _packed(rows.ravel())}
            )
        return [
            {"path": path, "clip": {"fps": 1, "name": "default", "tracks": tracks}}
            for path, tracks in clips.items()
        ]


def decomposed(matrix: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position (3,), quaternion (x, y, z, w) and scale (3,) of a matrix (4, 4), as three.js has them."""
    scale = np.linalg.norm(matrix[:3, :3], axis=0)
    if np.linalg.det(matrix[:3, :3]) < 0.0:
        scale[0] = -scale[0]
    rotation = matrix[:3, :3] / scale
    return matrix[:3, 3].copy(), np.array(pin.Quaternion(rotation).coeffs()), scale


def _packed(numbers: FloatArray | Sequence[float]) -> Any:
    return umsgpack.Ext(_FLOAT32, np.asarray(numbers, dtype=np.float32).tobytes())
