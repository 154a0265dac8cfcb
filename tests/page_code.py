"""Run the code blocks of a page of the documentation, and list the pictures that the page shows."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import matplotlib as mpl

__all__ = ["BY_COMMAND", "PYTHON", "run_page", "shown"]

PYTHON = re.compile(r"^```python\n(.*?)^```$", re.S | re.M)
_FILE = re.compile(r"^```toml\n# (\S+\.toml)\n(.*?)^```$", re.S | re.M)  # a file that the page uses
_PICTURE = re.compile(r"!\[[^]]*\]\((?:docs/)?images/([^)]+)\)")
# Pictures that are drawn by commands, which their pages name.
BY_COMMAND = {
    "capture.gif",
    "capture.png",
    "case-2-view.png",
    "clients.png",
    "coupling-map.png",
    "first-scene.png",
    "fixed-or-free.png",
    "inspect.gif",
    "trade-off.png",
    "two-arms.png",
}


def run_page(page: Path, folder: Path) -> dict[str, Any]:
    """Run a page's Python blocks in order in a folder, and return their global names."""
    text = page.read_text(encoding="utf-8")
    mpl.use("Agg")
    names: dict[str, Any] = {}
    before = Path.cwd()
    os.chdir(folder)
    try:
        for title, lines in _FILE.findall(text):
            Path(title).write_text(lines, encoding="utf-8")
        for block in PYTHON.findall(text):
            exec(compile(block, page.name, "exec"), names)
    finally:
        os.chdir(before)
    return names


def shown(page: Path) -> list[str]:
    """Return the pictures of a page that its code blocks must write."""
    pictures = _PICTURE.findall(page.read_text(encoding="utf-8"))
    return [name for name in pictures if name not in BY_COMMAND and not name.startswith("example-")]
