"""Where tables are printed."""

from __future__ import annotations

import os

from rich.console import Console

__all__ = ["output_console"]

_WIDTH = 100


def output_console() -> Console:
    """Console on the output stream: as wide as its terminal, or as a fixed width in files and pipes."""
    console = Console()
    if not console.is_terminal and "COLUMNS" not in os.environ:
        return Console(width=_WIDTH)
    return console
