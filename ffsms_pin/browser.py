"""A function that opens a page in the user's web browser."""

from __future__ import annotations

import os
import sys
import webbrowser
from pathlib import Path


def open_in_browser(page: Path) -> bool:
    """Open a file in the browser; return False if no display or no browser is available."""
    display = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    return (display or sys.platform in ("darwin", "win32")) and webbrowser.open(page.resolve().as_uri())
