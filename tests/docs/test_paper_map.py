"""Test that docs/paper-map.toml has existing code and tests for all equations, tables and figures."""

from __future__ import annotations

import importlib
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
ROWS: list[dict[str, Any]] = tomllib.loads((ROOT / "docs" / "paper-map.toml").read_text(encoding="utf-8"))[
    "row"
]
EQUATIONS = 53  # displayed in the paper, its appendix included
TABLES = 2
FIGURES = ("4a, 6a", "4b, 6b", "4c, 6c", "4d, 6d", "5a, 7a", "5b, 7b")  # of its results


def test_the_map_is_complete() -> None:
    numbers = [str(i) for i in range(1, EQUATIONS + 1)] + [f"Table {i}" for i in range(1, TABLES + 1)]
    assert [row["number"] for row in ROWS] == numbers + [f"Figures {panels}" for panels in FIGURES]


def resolved(name: str) -> Any:
    """Return the module, class, function or attribute of a dotted name."""
    parts = name.split(".")
    for cut in range(len(parts), 0, -1):
        try:
            thing = importlib.import_module(".".join(parts[:cut]))
        except ModuleNotFoundError:
            continue
        for part in parts[cut:]:
            thing = getattr(thing, part)
        return thing
    raise ModuleNotFoundError(name)


@pytest.mark.parametrize("name", sorted({name for row in ROWS for name in row["code"]}))
def test_the_code_of_a_row_exists(name: str) -> None:
    assert resolved(name) is not None


@pytest.mark.parametrize("name", sorted({name for row in ROWS for name in row["test"]}))
def test_the_test_of_a_row_exists(name: str) -> None:
    path, _, function = name.partition("::")
    text = (ROOT / path).read_text(encoding="utf-8")
    assert not function or re.search(rf"^def {function}\(", text, re.M)


def test_labels_that_docstrings_quote_are_in_the_map() -> None:
    """ "(paper Eq. DC_GJM)" in a docstring is a label of the map, without its prefix."""
    labels = {re.sub(r"^(Eq_|eqn?:|eqn_)", "", row.get("label", "")) for row in ROWS}
    quoted = set()
    for folder in ("ffsms_pin", "opt"):
        for path in (ROOT / folder).rglob("*.py"):
            quoted |= set(re.findall(r"Eq\. (\w+)", path.read_text(encoding="utf-8")))
    assert quoted <= labels
