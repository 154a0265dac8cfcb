"""Parse an exported page of the viewer, for tests."""

from __future__ import annotations

import base64
import gzip
import json
import re
import struct
from typing import Any

import numpy as np
import umsgpack
from numpy.typing import NDArray

__all__ = ["ExportedPage"]

Array = NDArray[np.float64]


class ExportedPage:
    """The facts and the Meshcat commands of an exported file."""

    def __init__(self, text: str) -> None:
        self.text = text
        match = re.search(r'<script id="facts" type="application/json">(.*?)</script>', text, re.S)
        assert match is not None
        self.facts: dict[str, Any] = json.loads(match[1])
        match = re.search(r'<script id="commands" type="text/plain">(.*?)</script>', text, re.S)
        assert match is not None
        raw = gzip.decompress(base64.b64decode(match[1]))
        self.commands: list[dict[str, Any]] = []
        at = 0
        while at < len(raw):
            (length,) = struct.unpack_from("<I", raw, at)
            self.commands.append(umsgpack.unpackb(raw[at + 4 : at + 4 + length]))
            at += 4 + length

    def of(self, kind: str) -> list[dict[str, Any]]:
        return [command for command in self.commands if command["type"] == kind]

    def track(self, path: str, name: str) -> tuple[Array, Array]:
        """Return times and values of a track of the animation."""
        (film,) = self.of("set_animation")
        (clip,) = [item["clip"] for item in film["animations"] if item["path"] == f"/ffsms/{path}"]
        (track,) = [item for item in clip["tracks"] if item["name"] == f".{name}"]
        times = np.frombuffer(track["times"].data, dtype=np.float32).astype(np.float64)
        values = np.frombuffer(track["values"].data, dtype=np.float32).astype(np.float64)
        return times, values.reshape(len(times), -1)
