"""`ffsms-pin docs` and `ffsms-pin quickstart`: a page of the documentation, and a notebook to begin with.

The pages are files: beside the package in a clone, inside it where it is installed.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from rich.markdown import Markdown
from rich.table import Table

import ffsms_pin
from ffsms_pin.cli.output import output_console, say
from ffsms_pin.errors import DependencyMissing, InvalidValue, ResultError, meant
from ffsms_pin.storage import write_content

__all__ = ["notebook", "page", "page_path", "page_titles", "quickstart"]


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


# Each cell with what is said above it. The tests run them.
_CELLS: tuple[tuple[str, str], ...] = (
    (
        "# A satellite that turns when its arm moves\n\n"
        "A robot: the planar satellite of the paper. A path to a URDF goes here as well; `ffsms.mount` puts "
        "an arm on a satellite of your choice.",
        "%matplotlib inline\nimport numpy as np\n\n"
        "import ffsms_pin as ffsms\nfrom ffsms_pin import opt, plotting\n\n"
        'sms = ffsms.load("planar_3r")\nsms',
    ),
    (
        "Its state at one posture, and how strongly joint motion moves the base (`sigma`).",
        "q0 = sms.configuration(np.radians([1.0, 1.0, 1.0]))\nsms.at(q0).coupling",
    ),
    (
        "A plan that brings the end effector to a target [m] in 12 s.",
        "plan = opt.plan(sms, q0, target=[0.45, 0.65, 0.0], duration=12.0)\nplan",
    ),
    ("The motion as a drawing.", "plotting.plot_motion(sms, plan).figure"),
    (
        "A controller follows the plan on the full dynamics, with nothing acting on the base.",
        "tracking = ffsms.simulate(sms, plan, ffsms.SlidingModeController(sms))\ntracking",
    ),
    ("The film: drag to turn it, use the slider to travel in time.", "ffsms.view(sms, tracking, plan)"),
)


def notebook() -> dict[str, Any]:
    """The notebook, as its JSON says (format 4.5)."""
    cells: list[dict[str, Any]] = []
    for i, (said, code) in enumerate(_CELLS):
        cells.append({"cell_type": "markdown", "id": f"text-{i}", "metadata": {}, "source": said})
        cell = {"cell_type": "code", "id": f"code-{i}", "metadata": {}, "source": code}
        cells.append(cell | {"execution_count": None, "outputs": []})
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    metadata = {"kernelspec": kernel, "language_info": {"name": "python"}}
    return {"cells": cells, "metadata": metadata, "nbformat": 4, "nbformat_minor": 5}


def quickstart(arguments: argparse.Namespace) -> int:
    """Write the notebook, and open it where that is asked for."""
    if not arguments.out.strip() or "\0" in arguments.out:
        raise InvalidValue("--out", arguments.out, "must name a file")
    if arguments.notebook and importlib.util.find_spec("jupyterlab") is None:
        raise DependencyMissing("jupyterlab", "opening a notebook", "notebooks")
    path = Path(arguments.out)
    if path.exists():
        raise ResultError(path, "is there already: move it away, or name another file with --out")
    write_content(path, (json.dumps(notebook(), indent=1) + "\n").encode())
    if arguments.notebook:
        say(f"{path} written")
        return subprocess.call([sys.executable, "-m", "jupyterlab", str(path)])
    say(f"{path} written. Open it with: jupyter lab {path} (pip install 'ffsms-pin[notebooks]')")
    return 0
