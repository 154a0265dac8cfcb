"""Make the page that lists the code and the test of each equation, table and figure of the paper."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

ROWS = Path(__file__).with_name("paper-map.toml")
HEAD = """# From the paper to the code

The tables list, in order, the equations, tables and figures with results of the paper by Das, Choi and Kim
(AAS 25-705). Each row has the code that computes the result and the test that checks this code. Names of
code are relative to `ffsms_pin`, and files of tests are relative to `tests`. Equations are numbered in the
order of the paper, including the appendix. The docstrings quote the labels in brackets, which come from the
paper's source. [Reproduce the paper](reproduce-the-paper.md) shows the figures.

"""


def rows() -> list[dict[str, Any]]:
    """Return a row for each equation, table and figure: `number`, `label`, `says`, `code`, `test`, `note`.

    The first row of a section has its title, `section`.
    """
    found: list[dict[str, Any]] = tomllib.loads(ROWS.read_text(encoding="utf-8"))["row"]
    return found


def page() -> str:
    """Return the page in Markdown, with a folded table for each section."""
    lines: list[str] = []
    for row in rows():
        if "section" in row:
            lines += ["", "</details>", ""] if lines else []
            lines += [f"<details><summary>{row['section']}</summary>", ""]
            lines += ["| paper | what it says | code; test |", "|---|---|---|"]
        label = f" ({row['label']})" if "label" in row else ""
        code = [f"`{name.removeprefix('ffsms_pin.')}`" for name in row["code"]]
        test = [f"`{name.removeprefix('tests/')}`" for name in row["test"]]
        note = f". {row['note']}" if "note" in row else ""
        where = f"{', '.join(code)}; {', '.join(test)}"
        lines.append(f"| {row['number']}{label} | {row['says']}{note} | {where} |")
    return HEAD + "\n".join([*lines, "", "</details>"]) + "\n"
