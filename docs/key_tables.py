"""Make the tables of docs/scenario-keys.md from the models of the keys."""

from __future__ import annotations

import re
from typing import get_args

from ffsms_pin.options.tables import Keys, about, models_in
from ffsms_pin.scenarios.tables import ScenarioFile

__all__ = ["key_tables", "with_key_tables"]

_HEAD = "| key | unit | default | what it is |\n|---|---|---|---|\n"
_NAME = re.compile(r"## \[+([\w.]+)\]+\n")
_TABLE = re.compile(r"^\| key \| unit .*\n(?:\|.*\n)*", re.M)


def key_tables() -> dict[str, str]:
    """Return a Markdown table for each table of a scenario file, by its name such as "plan.base_limits"."""
    found: dict[str, str] = {}
    for name, field in ScenarioFile.model_fields.items():
        _add(found, name, models_in(field.annotation))
    return found


def with_key_tables(page: str) -> str:
    """Return the page with the current tables under its headings, such as `## [plan]`."""
    made = key_tables()
    before, *sections = re.split(r"^(?=## )", page, flags=re.M)
    done = [before]
    for section in sections:
        name = _NAME.match(section)
        if name is not None and (table := made.get(name[1])) is not None:
            section = _TABLE.sub(table.replace("\\", r"\\"), section, count=1)
        done.append(section)
    return "".join(done)


def _add(found: dict[str, str], name: str, models: list[type[Keys]]) -> None:
    """Add the Markdown table of the file's table `name` to `found`.

    If the table has several models, each model is a choice. The keys of all choices come first, then the
    other keys with the names of their choices.
    """
    choices: dict[tuple[str, ...], list[str]] = {}
    for model in models:
        (choice,) = get_args(model.model_fields[model.chooser].annotation) if model.chooser else ("",)
        for key, field in model.model_fields.items():
            if inner := models_in(field.annotation):
                _add(found, f"{name}.{key}", inner)
                continue
            more, what = about(field), field.description
            if key == "use" and choice:
                what = f'"{choice}": {model.__doc__}'.rstrip(".")
            cells = (
                f"`{key}`" + " °" * more["degrees"],
                more["unit"],
                more["default_in_words"],
                what.replace("|", r"\|"),
            )
            choices.setdefault(cells, []).append(f'"{choice}"')
    rows = [_row(*cells) for cells, names in choices.items() if len(names) == len(models)]
    for (*cells, what), names in choices.items():
        if len(names) < len(models):
            of = "" if cells[0] == "`use`" else f"of {', '.join(names)}: "
            rows.append(_row(*cells, (of + what).removesuffix(": ")))
    found[name] = _HEAD + "".join(rows)


def _row(*cells: str) -> str:
    return "|" + "|".join(f" {cell} " if cell else " " for cell in cells).replace("\n", " ") + "|\n"


if __name__ == "__main__":
    import sys
    from pathlib import Path

    for one in map(Path, sys.argv[1:]):
        one.write_text(with_key_tables(one.read_text("utf-8")), encoding="utf-8")
