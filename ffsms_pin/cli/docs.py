"""Files that come with the package, as text: `ffsms-pin docs`, `scenario` and `quickstart`."""

from __future__ import annotations

import argparse
import importlib.util
import json
import subprocess
import sys
from collections.abc import Collection
from pathlib import Path

from rich.markdown import Markdown
from rich.table import Table

import ffsms_pin
from ffsms_pin.cli.output import output_console, say
from ffsms_pin.errors import DependencyMissing, InvalidValue, ResultError, meant
from ffsms_pin.storage import write_content


def page(arguments: argparse.Namespace) -> int:
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
    """Where the pages are: beside the package in a clone, inside it where it is installed."""
    package = Path(ffsms_pin.__file__).parent
    inside = package / "docs"
    return inside if inside.is_dir() else package.parent / "docs"


def page_titles() -> dict[str, str]:
    """Titles of all pages by their names, as {"scenarios": "Scenario files"}."""
    pages = sorted(_folder().glob("*.md"))
    heads = (page.read_text("utf-8").lstrip().partition("\n")[0] for page in pages)
    return {page.stem: head.lstrip("# ").strip() for page, head in zip(pages, heads, strict=True)}


def page_path(name: str) -> Path:
    """The file of a page; `InvalidValue` says which names are near where there is none of this one."""
    word = name.removeprefix("docs/").removesuffix(".md")
    return _folder() / f"{_known('PAGE', word, page_titles())}.md"


def _known(name: str, word: str, known: Collection[str]) -> str:
    """A word that is known; `InvalidValue` says which one was meant."""
    if word not in known:
        raise InvalidValue(name, word, f"must be one of {', '.join(known)}{meant(word, known, '; ')}")
    return word


def quickstart(arguments: argparse.Namespace) -> int:
    """Write the notebook, and open it where that is asked for."""
    if not arguments.out.strip() or "\0" in arguments.out:
        raise InvalidValue("--out", arguments.out, "must name a file")
    if arguments.notebook and importlib.util.find_spec("jupyterlab") is None:
        raise DependencyMissing("jupyterlab", "opening a notebook", "notebooks")
    path = Path(arguments.out)
    if path.exists():
        raise ResultError(path, "is there already: move it away, or name another file with --out")
    write_content(path, Path(__file__).with_name("quickstart.ipynb").read_bytes())
    if arguments.notebook:
        say(f"{path} written")
        return subprocess.call([sys.executable, "-m", "jupyterlab", str(path)])
    say(f"{path} written. Open it with: jupyter lab {path} (pip install 'ffsms-pin[notebooks]')")
    return 0


def scenario_file(arguments: argparse.Namespace) -> int:
    """Print a packaged scenario file, or the JSON Schema of all of them."""
    from ffsms_pin.scenarios.file import packaged_path, scenario_names, schema

    if arguments.schema:
        sys.stdout.write(json.dumps(schema(), indent=2, ensure_ascii=False) + "\n")
        return 0
    name = _known("--print", arguments.name, scenario_names())
    sys.stdout.write(packaged_path(name).read_text(encoding="utf-8"))
    return 0
