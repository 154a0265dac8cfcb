"""A table with one column for each of several things that are compared."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

__all__ = ["Rows", "side_by_side"]

Rows = Mapping[str, Callable[[dict[str, Any]], str]]


def side_by_side(title: str, numbers: Mapping[str, dict[str, Any]], rows: Rows) -> Any:
    """A rich table: a column for each key of `numbers`, a line for each label of `rows`."""
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=escape(title), title_justify="left")
    table.add_column("quantity")
    for name in numbers:
        table.add_column(name, justify="right")
    for label, value in rows.items():
        table.add_row(escape(label), *(value(one) for one in numbers.values()))
    return table
