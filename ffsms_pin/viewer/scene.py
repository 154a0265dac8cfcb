"""A Meshcat scene that needs no server: every drawing command is kept, and can be written or sent later."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import umsgpack

from ffsms_pin.viewer.film import Film

__all__ = ["Scene", "Sink"]


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
