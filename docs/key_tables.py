"""The keys of scenario files as tables of a page: unit, default and meaning of each, from the models."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from ffsms_pin.scenarios.keys import Keys, about, models_in, words
from ffsms_pin.scenarios.tables import PARTS, ScenarioFile

__all__ = ["key_tables", "with_key_tables"]

_HEAD = "| key | unit | default | what it is |\n|---|---|---|---|\n"
_NAME = re.compile(r"## \[+([\w.]+)\]+\n")
_TABLE = re.compile(r"^\| key \| unit .*\n(?:\|.*\n)*", re.M)


def key_tables() -> dict[str, str]:
    """A Markdown table for each table of a scenario file, by its name, as "plan.base_limits"."""
    found: dict[str, str] = {}
    for name, field in ScenarioFile.model_fields.items():
        if name in PARTS:
            found[name] = _HEAD + _of_parts(PARTS[name])
        else:
            _add(found, name, models_in(field.annotation)[0])
    return found


def with_key_tables(page: str) -> str:
    """A page with the tables under its headings, as `## [plan]`, made anew."""
    made = key_tables()
    before, *sections = re.split(r"^(?=## )", page, flags=re.M)
    done = [before]
    for section in sections:
        name = _NAME.match(section)
        if name is not None and (table := made.get(name[1])) is not None:
            section = _TABLE.sub(table.replace("\\", r"\\"), section, count=1)
        done.append(section)
    return "".join(done)


def _add(found: dict[str, str], name: str, model: type[Keys]) -> None:
    rows = []
    for key, field in model.model_fields.items():
        if inner := models_in(field.annotation):
            _add(found, f"{name}.{key}", inner[0])
        else:
            rows.append(_row(key, about(field), words(field)))
    found[name] = _HEAD + "".join(rows)


def _row(key: str, more: Mapping[str, Any], what: str) -> str:
    angle = " °" if more["degrees"] else ""
    cells = (f"`{key}`{angle}", more["unit"], more["default_in_words"], what.replace("|", r"\|"))
    return "|" + "|".join(f" {cell} " if cell else " " for cell in cells) + "|\n"


def _of_parts(tables: Mapping[str, type[Keys]]) -> str:
    """Rows of tables that go by `use`: each of them, then the keys beside it."""
    plain = {"degrees": False, "unit": "", "default_in_words": ""}
    rows = []
    for use, table in tables.items():
        for key, field in table.model_fields.items():
            what = words(field)
            if key == "use":
                rows.append(_row("use", plain, what if use == "own" else f'"{use}": {what}'))
            else:
                rows.append(_row(key, about(field), f'of "{use}"' + (f": {what}" if what else "")))
    return "".join(rows)


if __name__ == "__main__":
    import sys
    from pathlib import Path

    for one in map(Path, sys.argv[1:]):
        one.write_text(with_key_tables(one.read_text("utf-8")), encoding="utf-8")
