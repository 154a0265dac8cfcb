"""The page that leads from each equation and table of the paper to the code and to its test."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

ROWS = Path(__file__).with_name("paper-map.toml")
HEAD = """# From the paper to the code

Each equation of Das, Choi and Kim (AAS 25-705), in order, and each of its tables: what it says, where
it is computed, and the test that checks it. The names in brackets are the labels in the paper's source, which
the docstrings quote. Numbers count the displayed equations from the first to the last, the appendix included.

"""


def rows() -> list[dict[str, Any]]:
    """One for each equation and table: `number`, `label`, `says`, `code`, `test`, `note`."""
    found: list[dict[str, Any]] = tomllib.loads(ROWS.read_text(encoding="utf-8"))["row"]
    return found


def page() -> str:
    """The page in Markdown."""
    lines = ["| paper | what it says | code | test |", "|---|---|---|---|"]
    for row in rows():
        label = f" ({row['label']})" if "label" in row else ""
        code = "<br>".join(f"`{name}`" for name in row["code"])
        test = "<br>".join(f"`{name}`" for name in row["test"])
        note = f" {row['note']}" if "note" in row else ""
        lines.append(f"| {row['number']}{label} | {row['says']}{note} | {code} | {test} |")
    return HEAD + "\n".join(lines) + "\n"
