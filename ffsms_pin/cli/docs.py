"""`ffsms-pin docs`: a page of the documentation in the terminal.

The pages are files: beside the package in a clone, inside it where it is installed.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.markdown import Markdown
from rich.table import Table

import ffsms_pin
from ffsms_pin.cli.output import output_console, say
from ffsms_pin.errors import InvalidValue, meant

__all__ = ["page_path", "page_titles", "run"]


def run(arguments: argparse.Namespace) -> int:
    """Print a page, or the list of them."""
    output = output_console()
    if arguments.page is None:
        table = Table("page", "about", box=None, padding=(0, 2))
        for name, title in page_titles().items():
            table.add_row(name, title)
        output.print(table)
        return 0
    path = page_path(arguments.page)
    if arguments.path:
        say(str(path))
        return 0
    text = path.read_text("utf-8")
    if output.is_terminal:
        with output.pager(styles=True):
            output.print(Markdown(text))
    else:
        say(text)
    return 0


def _folder() -> Path:
    package = Path(ffsms_pin.__file__).parent
    inside = package / "docs"
    return inside if inside.is_dir() else package.parent / "docs"


def page_titles() -> dict[str, str]:
    """Titles of all pages by their names, as {"scenarios": "Scenario files"}."""
    found = {}
    for path in sorted(_folder().glob("*.md")):
        first = path.read_text("utf-8").lstrip().partition("\n")[0]
        found[path.stem] = first.lstrip("# ").strip()
    return found


def page_path(name: str) -> Path:
    """The file of a page; `InvalidValue` says which names are near where there is none of this one."""
    titles = page_titles()
    word = name.removeprefix("docs/").removesuffix(".md")
    if word not in titles:
        raise InvalidValue("PAGE", name, f"must be one of {', '.join(titles)}{meant(word, titles, '; ')}")
    return _folder() / f"{word}.md"
