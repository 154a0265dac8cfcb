"""The page that leads from each equation, table and figure of the paper to the code and to its test."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

ROWS = Path(__file__).with_name("paper-map.toml")
HEAD = """# From the paper to the code

Each equation of Das, Choi and Kim (AAS 25-705), in order, each of its tables and its figures of results:
where it is computed, and the test that checks it. Names of code are below `ffsms_pin`, tests below
`tests`. The labels in brackets are those of the paper's source, which the docstrings quote. Numbers
count the displayed equations, the appendix included. The figures, drawn, are in [reproduce the
paper](reproduce-the-paper.md).

"""


def rows() -> list[dict[str, Any]]:
    """Return a row for each equation, table and figure: `number`, `label`, `says`, `code`, `test`, `note`.

    The first row of a section has its title, `section`.
    """
    found: list[dict[str, Any]] = tomllib.loads(ROWS.read_text(encoding="utf-8"))["row"]
    return found


def page() -> str:
    """Return the page in Markdown, each section's table folded."""
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
