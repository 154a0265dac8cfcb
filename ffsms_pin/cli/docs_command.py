"""`ffsms-pin docs`: a page of the documentation in the terminal."""

from __future__ import annotations

import argparse
from typing import Any

__all__ = ["add_parser", "run"]

_DESCRIPTION = """\
Show a page of the documentation, as it came with this version; without a name, the list of pages.

examples:
  ffsms-pin docs                  what there is
  ffsms-pin docs scenarios        every table and key of a scenario file
  ffsms-pin docs scenarios --path where the page is
"""


def add_parser(subparsers: Any) -> None:
    """Add `docs` to the commands (argparse's subparsers)."""
    parser = subparsers.add_parser(
        "docs",
        help="show a page of the documentation",
        description=_DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("page", metavar="PAGE", nargs="?", help="name of a page (default: list them)")
    parser.add_argument("--path", action="store_true", help="print where its file is, not what it says")


def run(arguments: argparse.Namespace) -> int:
    """Print a page, or the list of them; returns the exit code."""
    from rich.markdown import Markdown
    from rich.table import Table

    from ffsms_pin.cli.output import output_console
    from ffsms_pin.cli.pages import page_path, page_titles

    output = output_console()
    if arguments.page is None:
        table = Table("page", "about", box=None, padding=(0, 2))
        for name, title in page_titles().items():
            table.add_row(name, title)
        output.print(table)
        return 0
    path = page_path(arguments.page)
    if arguments.path:
        output.print(str(path), markup=False, highlight=False, soft_wrap=True)
        return 0
    text = path.read_text("utf-8")
    if output.is_terminal:
        with output.pager(styles=True):
            output.print(Markdown(text))
    else:
        output.print(text, markup=False, highlight=False, soft_wrap=True)
    return 0
