"""A Meshcat scene that needs no server: every drawing command is kept, and key frames make its film."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import pinocchio as pin
import umsgpack
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import ViewerError

__all__ = ["Film", "Scene", "SceneLog", "Sink", "decomposed"]

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


class Sink(Protocol):
    """What takes packed commands: a running server."""

    def forward(self, kind: str, path: str, name: str, packed: bytes) -> None:
        """Take one command; `name` is that of the property, where it sets one."""


@dataclass
class _Node:
    """The commands that make one node of the scene tree what it is."""

    object: bytes | None = None
    transform: bytes | None = None
    properties: dict[str, bytes] = field(default_factory=dict)


class Scene:
    """Stands where Meshcat's `Visualizer` expects its window to a server.

    Commands are kept by path, the last of a kind counts, as the server does it. While `filming`, transforms
    become key frames instead.
    """

    def __init__(self) -> None:
        self._nodes: dict[str, _Node] = {}
        self._film: Film | None = None
        self._time = 0.0
        self._sink: Sink | None = None

    def send(self, command: Any) -> None:
        """Take a command of Meshcat's Python package (an object with `lower()`)."""
        if self._film is not None and type(command).__name__ == "SetTransform":
            self._film.place(command.path.lower(), self._time, np.asarray(command.matrix))
            return
        data = command.lower()
        self._keep(data["type"], data["path"], data)

    @property
    def frame_time(self) -> float | None:
        """Time [s] of the frame that is being filmed; None outside of `filming`."""
        return self._time if self._film is not None else None

    @contextmanager
    def filming(self, film: Film, time: float) -> Iterator[None]:
        """Inside the block, transforms go to `film` as key frames at `time` [s]."""
        self._film, self._time = film, time
        try:
            yield
        finally:
            self._film = None

    def attach(self, sink: Sink) -> None:
        """Send everything to a server, and from now on every command as it comes."""
        for command in self._all():
            sink.forward(*command)
        self._sink = sink

    def detach(self) -> None:
        """Send no more."""
        self._sink = None

    @property
    def paths(self) -> list[str]:
        """Paths of everything that the scene holds."""
        return list(self._nodes)

    def commands(self) -> list[bytes]:
        """Packed commands that build the scene, in order."""
        return [packed for *_, packed in self._all()]

    def _all(self) -> Iterator[tuple[str, str, str, bytes]]:
        for path, node in self._nodes.items():
            if node.object is not None:
                yield "set_object", path, "", node.object
            for name, packed in node.properties.items():
                yield "set_property", path, name, packed
            if node.transform is not None:
                yield "set_transform", path, "", node.transform

    def _keep(self, kind: str, path: str, data: dict[str, Any]) -> None:
        packed = umsgpack.packb(data)
        if kind == "delete":
            below = path.rstrip("/") + "/"
            for known in [known for known in self._nodes if (known + "/").startswith(below)]:
                del self._nodes[known]
        else:
            node = self._nodes.setdefault(path, _Node())
            if kind == "set_object":
                node.object = packed
                node.properties.clear()
            elif kind == "set_transform":
                node.transform = packed
            elif kind == "set_property":
                node.properties[data["property"]] = packed
        if self._sink is not None:
            self._sink.forward(kind, path, data.get("property", ""), packed)


class SceneLog:
    """Written by the thread that draws, read by the thread that serves.

    A page that is too slow for every command skips those that later ones have replaced, so what is kept is
    bounded by the scene, not by the length of the run.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._count = 0
        # By kind, path and property: the command's number and the packed command. A dict keeps its order;
        # a command that replaces another one goes to the end.
        self._latest: dict[tuple[str, str, str], tuple[int, bytes]] = {}

    def put(self, kind: str, path: str, name: str, packed: bytes) -> None:
        """Take one command.

        Parameters
        ----------
        kind : str
            Type of the command.
        path : str
            Of the node.
        name : str
            Of the property, for `set_property`; otherwise empty.
        packed : bytes
            The whole command.

        Raises
        ------
        ViewerError
            A kind of command that the live page is not sent.
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
        """What came after the first `count` commands.

        Parameters
        ----------
        count : int
            What the last call returned; 0 for a new page.

        Returns
        -------
        count : int
            Number of commands so far.
        commands : list of bytes
            In order, without those that later ones replaced.
        """
        found: list[bytes] = []
        with self._lock:
            for number, packed in reversed(self._latest.values()):
                if number <= count:
                    break
                found.append(packed)
            return self._count, found[::-1]

    def _drop(self, keys: list[tuple[str, str, str]]) -> None:
        for key in keys:
            self._latest.pop(key, None)
