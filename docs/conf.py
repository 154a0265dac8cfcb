"""The configuration of Sphinx for `make docs`."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

import agreement  # noqa: E402
import paper_map  # noqa: E402
import records  # noqa: E402
from sphinx.errors import ConfigError  # noqa: E402

sys.path.insert(0, str(HERE.parent / "tests"))

from lessons import check_built, check_offline, warnings_are_errors  # noqa: E402

from ffsms_pin.version import __version__  # noqa: E402

project = "ffsms-pin"
author = "The ffsms-pin developers"
copyright = author
release = version = __version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",
    "sphinx_copybutton",
]
html_theme = "furo"
html_title = f"ffsms-pin {__version__}"
exclude_patterns = ["_build", "jupyter_execute", "lessons/README.md", "records"]
suppress_warnings = [
    "mystnb.unknown_mime_type",  # the type of Meshcat's scenes; the page shows their HTML
    "ref.python",  # a name such as `duration` refers to several attributes, so it has no link
]

myst_enable_extensions = ["dollarmath", "amsmath", "deflist"]
myst_heading_anchors = 3

# Every lesson runs while the site is built, unless NOTEBOOKS=off is set for a fast build.
nb_execution_mode = os.environ.get("NOTEBOOKS", "force")
nb_execution_timeout = 600  # [s] limit of one cell
nb_execution_raise_on_error = True
nb_merge_streams = True
warnings_are_errors(HERE / "_build" / "ipython")

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings have types with shapes and units
napoleon_google_docstring = False
napoleon_use_ivar = True  # attributes are described in the class, once

# The lessons are copies of the notebooks, because Sphinx reads only files below its own folder.
shutil.copytree(HERE.parent / "notebooks", HERE / "lessons", dirs_exist_ok=True)
(HERE / "paper-map.md").write_text(paper_map.page(), encoding="utf-8")
(HERE / "agreement.md").write_text(agreement.page(), encoding="utf-8")

if wrong := [line for path in records.pages() for line in records.faults(path)]:
    raise ConfigError("\n".join(wrong))


def setup(app: Any) -> None:
    """Register the project's own build steps."""
    app.connect("autodoc-process-docstring", _bars)
    app.connect("build-finished", _check_lessons)
    app.connect("source-read", _mark_changed)
    app.connect("build-finished", _check_offline)


def _mark_changed(app: Any, page: str, text: list[str]) -> None:
    """Mark the records of a page whose command has changed since the run."""
    text[0] = records.marked(text[0])


def _check_lessons(app: Any, exception: Exception | None) -> None:
    """Check that all lessons ran without errors."""
    if exception is None and nb_execution_mode != "off":
        check_built(Path(app.outdir).parent / "jupyter_execute" / "lessons")


def _check_offline(app: Any, exception: Exception | None) -> None:
    """Check that the pages need no network, equations included."""
    if exception is None:
        check_offline(Path(app.outdir))


def _bars(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Escape bars in a docstring, because |x| is a norm here and not a substitution of reStructuredText."""
    lines[:] = [line.replace("|", "\\|") for line in lines]
