"""A Meshcat scene that needs no server: the latest of every drawing command, and key frames for its film."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import pinocchio as pin
import umsgpack
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import ViewerError

__all__ = ["Film", "Scene"]

_FLOAT32 = 0x17  # the extension type under which Meshcat's page reads an array of floats
_STILL = 1e-7
# What draws and moves things. Meshcat's page knows more commands, and one of them (`set_control`) evaluates
# a text that comes with it: none of those ever leaves this process.
_KINDS = ("set_object", "set_transform", "set_property", "set_animation", "delete")


class Film:
    """Tracks of key frames, by the path of the node and the name of its property in three.js."""

    def __init__(self) -> None:
        self._tracks: dict[tuple[str, str, str], tuple[list[float], list[FloatArray]]] = {}

    def key(self, path: str, name: str, kind: str, time: float, value: ArrayLike) -> None:
        """Add a key frame of a node's property, such as "position", at a time [s] that grows.

        The kind of track is three.js': "vector3", "quaternion", "color", "number".
        """
        times, values = self._tracks.setdefault((path, name, kind), ([], []))
        times.append(time)
        values.append(np.atleast_1d(np.asarray(value, dtype=np.float64)))

    def place(self, path: str, time: float, matrix: FloatArray) -> None:
        """Add key frames of position, attitude and size from a matrix (4, 4)."""
        scale = np.linalg.norm(matrix[:3, :3], axis=0)
        if np.linalg.det(matrix[:3, :3]) < 0.0:
            scale[0] = -scale[0]
        self.key(path, "position", "vector3", time, matrix[:3, 3].copy())
        self.key(path, "quaternion", "quaternion", time, pin.Quaternion(matrix[:3, :3] / scale).coeffs())
        self.key(path, "scale", "vector3", time, scale)

    def command(self, speed: float) -> bytes:
        """The packed command that plays it over and over, `speed` times as fast: one clip a node."""
        clips: dict[str, list[dict[str, Any]]] = {}
        for (path, name, kind), (times, values) in self._tracks.items():
            at, rows = np.array(times) / speed, np.array(values)
            if np.ptp(rows, axis=0).max() <= _STILL:  # two keys say that nothing happens
                at, rows = at[[0, -1]], rows[[0, -1]]
            clips.setdefault(path, []).append(
                {"name": f".{name}", "type": kind, "times": _packed(at), "values": _packed(rows.ravel())}
            )
        animations = [
            {"path": path, "clip": {"fps": 1, "name": "default", "tracks": tracks}}
            for path, tracks in clips.items()
        ]
        options = {"play": True, "repetitions": 1_000_000}
        data = {"type": "set_animation", "path": "", "animations": animations, "options": options}
        return bytes(umsgpack.packb(data))


def _packed(numbers: FloatArray | Sequence[float]) -> Any:
    return umsgpack.Ext(_FLOAT32, np.asarray(numbers, dtype=np.float32).tobytes())


class Scene:
    """Stands where Meshcat's `Visualizer` expects its window to a server; the thread of a live page reads it.

    A page that is too slow for every command skips those that later ones have replaced, so what is kept is
    bounded by the scene, not by the length of a run. While `filming`, transforms become key frames instead.

    Attributes
    ----------
    film : Film
    frame_time : float or None
        [s] of the frame that is being filmed.
    """

    def __init__(self) -> None:
        self.film = Film()
        self.frame_time: float | None = None
        self._lock = threading.Lock()
        self._count = 0
        # By kind, path and property: the command's number and the packed command. A dict keeps its order;
        # a command that replaces another one goes to the end.
        self._latest: dict[tuple[str, str, str], tuple[int, bytes]] = {}

    def send(self, command: Any) -> None:
        """Take a command of Meshcat's Python package (an object with `lower()`)."""
        if self.frame_time is not None and type(command).__name__ == "SetTransform":
            self.film.place(command.path.lower(), self.frame_time, np.asarray(command.matrix))
            return
        data = command.lower()
        self.put(data["type"], data["path"], data.get("property", ""), umsgpack.packb(data))

    @contextmanager
    def filming(self, time: float) -> Iterator[None]:
        """Inside the block, transforms are key frames at `time` [s]."""
        self.frame_time = time
        try:
            yield
        finally:
            self.frame_time = None

    def put(self, kind: str, path: str, name: str, packed: bytes) -> None:
        """Take a packed command on a node; `name` is that of the property, where it sets one, or empty.

        Raises
        ------
        ViewerError
            A kind of command that no page is sent.
        """
        if kind not in _KINDS:
            raise ViewerError(f"the live page is not sent commands of the kind '{kind}'; use {_KINDS}")
        with self._lock:
            if kind == "delete":
                below = path.rstrip("/") + "/"
                self._drop([key for key in self._latest if (key[1] + "/").startswith(below)])
            elif kind == "set_object":  # a new object has its properties still to come
                self._drop([key for key in self._latest if key[:2] == ("set_property", path)])
            self._count += 1
            self._drop([(kind, path, name)])
            self._latest[kind, path, name] = (self._count, packed)

    def since(self, count: int) -> tuple[int, list[bytes]]:
        """The number of commands so far, and those after the first `count`, in order.

        Those that later ones replaced are left out.
        """
        found: list[bytes] = []
        with self._lock:
            for number, packed in reversed(self._latest.values()):
                if number <= count:
                    break
                found.append(packed)
            return self._count, found[::-1]

    @property
    def paths(self) -> list[str]:
        """Paths of everything that the scene holds."""
        return list(dict.fromkeys(path for _, path, _ in self._latest))

    def commands(self) -> list[bytes]:
        """Packed commands that build the scene, in order, without those that play its film."""
        return [packed for (kind, *_), (_, packed) in self._latest.items() if kind != "set_animation"]

    def _drop(self, keys: list[tuple[str, str, str]]) -> None:
        for key in keys:
            self._latest.pop(key, None)
