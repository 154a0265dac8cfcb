"""Check executed notebooks and the built site, for `make docs` and for tests."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import nbformat

__all__ = ["check_built", "check_offline", "faults", "warnings_are_errors"]

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
_PICTURES = ("text/html", "image/png")
_OUTSIDE = re.compile(r"""<script\b[^>]*\bsrc=["']?((?:https?:)?//[^"'\s>]+)""")
# Warnings of the kernel itself are ignored.
_STRICT = """import warnings
warnings.simplefilter("error")
warnings.filterwarnings("ignore", module="ipykernel")
"""


def warnings_are_errors(folder: Path) -> None:
    """Let later notebook kernels turn warnings into errors; `folder` stores their settings."""
    startup = folder / "profile_default" / "startup"
    startup.mkdir(parents=True, exist_ok=True)
    (startup / "strict.py").write_text(_STRICT, encoding="utf-8")
    os.environ["IPYTHONDIR"] = str(folder)


def faults(notebook: Any) -> list[str]:
    """Return the faults of an executed notebook (nbformat)."""
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    streams = [output for output in outputs if output.output_type == "stream"]
    problems = [f"it complains: {output.text.strip()}" for output in streams if output.name == "stderr"]
    problems += [f"it raises {output.ename}" for output in outputs if output.output_type == "error"]
    shown = [output for output in outputs if output.output_type in ("display_data", "execute_result")]
    if not any(kind in output.get("data", {}) for output in shown for kind in _PICTURES):
        problems.append("it shows no picture")
    # The text of the lessons assumes that every plan reaches its target.
    printed = "".join(output.text for output in streams)
    if "reached: False" in printed or "reached False" in printed:
        problems.append("a plan does not reach its target")
    return problems


def check_built(folder: Path) -> None:
    """Check the notebooks that Sphinx has executed into `folder`; raise RuntimeError with all faults."""
    problems = []
    for path in NOTEBOOKS:
        ran = folder / path.name
        if not ran.is_file():
            problems.append(f"{path.name}: it was not run")
            continue
        notebook = nbformat.read(ran, as_version=4)  # type: ignore[no-untyped-call]
        problems += [f"{path.name}: {fault}" for fault in faults(notebook)]
    if problems:
        raise RuntimeError("; ".join(problems))


def check_offline(site: Path) -> None:
    """Check that no page of a built site loads a script from another site; raise RuntimeError otherwise."""
    problems = [
        f"{page.relative_to(site)}: {script}"
        for page in sorted(site.rglob("*.html"))
        for script in _OUTSIDE.findall(page.read_text(encoding="utf-8"))
    ]
    if problems:
        raise RuntimeError(f"scripts from elsewhere: {'; '.join(problems)}")
