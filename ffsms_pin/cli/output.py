"""What commands print: on the output stream, tables and lines of plain text."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Mapping
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

__all__ = [
    "NO_FIGURES",
    "Rows",
    "desktop",
    "limit_text",
    "new_table",
    "output_console",
    "range_text",
    "say",
    "side_by_side",
]

NO_FIGURES = "no figures: they need matplotlib (pip install 'ffsms-pin[plot]')"
_WIDTH = 100

# What a table of things that are compared says of each, by the label of its line.
Rows = Mapping[str, Callable[[dict[str, Any]], str]]


def output_console() -> Console:
    """Console on the output stream: as wide as its terminal, or as a fixed width in files and pipes."""
    console = Console()
    if not console.is_terminal and "COLUMNS" not in os.environ:
        return Console(width=_WIDTH)
    return console


def say(*lines: str) -> None:
    """Print lines as they are: nothing in them is markup, and none is broken."""
    output = output_console()
    for line in lines:
        output.print(line, markup=False, highlight=False, soft_wrap=True)


def new_table(title: str, first: str, *numbers: str) -> Table:
    """A table of a first column of names and others of numbers; nothing in its heads is markup."""
    table = Table(title=escape(title), title_justify="left")
    table.add_column(escape(first))
    for name in numbers:
        table.add_column(escape(name), justify="right")
    return table


def side_by_side(title: str, numbers: Mapping[str, dict[str, Any]], rows: Rows) -> Table:
    """A column for each key of `numbers`, a line for each label of `rows`."""
    table = new_table(title, "quantity", *numbers)
    for label, value in rows.items():
        table.add_row(escape(label), *(value(one) for one in numbers.values()))
    return table


def desktop() -> bool:
    """Whether there is a display to open a window on."""
    return sys.platform in ("darwin", "win32") or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    )


def limit_text(value: float | None, unit: str) -> str:
    """A limit with its unit; "none" for None and infinity."""
    return f"{value:.4g} {unit}" if _exists(value) else "none"


def range_text(lower: float | None, upper: float | None, unit: str) -> str:
    """Lower and upper limit with their unit."""
    if not _exists(lower) and not _exists(upper):
        return "none"
    low = f"{lower:.4g}" if _exists(lower) else "-inf"
    high = f"{upper:.4g}" if _exists(upper) else "inf"
    return f"{low} to {high} {unit}"


def _exists(value: float | None) -> bool:
    return value is not None and math.isfinite(value)
