"""One HTML file with everything in it: Meshcat's page, the scene, the film, a legend and a time slider."""

from __future__ import annotations

import base64
import gzip
import html
import json
import struct
from collections.abc import Sequence
from importlib.resources import files
from typing import Any

__all__ = ["page"]


def page(title: str, commands: Sequence[bytes], facts: dict[str, Any]) -> str:
    """The text of the file.

    Parameters
    ----------
    title : str
    commands : sequence of bytes
        Meshcat's commands, packed, in order.
    facts : dict
        What the legend and the read-out show; see `page.html`.
    """
    framed = b"".join(struct.pack("<I", len(command)) + command for command in commands)
    # Without a time in the archive, the same scene gives the same text.
    packed = base64.b64encode(gzip.compress(framed, mtime=0)).decode("ascii")
    parts = {
        "TITLE": html.escape(title),
        "MESHCAT": (files("meshcat") / "viewer" / "dist" / "main.min.js").read_text("utf-8"),
        # Nothing in it may end the element that it stands in.
        "FACTS": json.dumps(facts, allow_nan=False).replace("<", "\\u003c"),
        "COMMANDS": packed,
    }
    text = (files("ffsms_pin.viewer") / "page.html").read_text("utf-8")
    for name, value in parts.items():
        text = text.replace(f"%%{name}%%", value)
    return text
