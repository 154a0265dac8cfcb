"""Run the shortest notebook, and test the checks of executed notebooks.

`make docs` runs every notebook in its own kernel, with warnings as errors, and fails if `lessons.faults`
finds a fault. `.ci/run` runs the tests and `make docs`.
"""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import nbformat
import pytest
from lessons import NOTEBOOKS, ROOT, check_built, check_offline, faults, warnings_are_errors
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError

SHORTEST = ROOT / "notebooks" / "07-your-own-urdf.ipynb"
MOST = 600  # [s] limit for a cell that hangs; a notebook should take less than a minute

# The kernel's sockets are closed shortly after a test.
pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning")


def executed(notebook: Any, folder: Path) -> Any:
    """Execute a notebook, and return it with its outputs."""
    resources = {"metadata": {"path": str(folder)}}
    return NotebookClient(notebook, timeout=MOST, kernel_name="python3", resources=resources).execute()


@pytest.fixture
def strict(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("IPYTHONDIR", "")  # restores the variable after the test
    warnings_are_errors(tmp_path / "ipython")


def test_names_in_lessons_exist_after_a_plain_import() -> None:
    """Lessons use subpackages as attributes of the library, so a plain import must suffice."""
    text = "".join(path.read_text(encoding="utf-8") for path in NOTEBOOKS)
    chains = sorted(set(re.findall(r"\bffsms(?:\.[a-zA-Z_]+)+", text)))
    assert "ffsms.control.Coordinated" in chains
    code = "; ".join(["import ffsms_pin as ffsms", *chains])
    subprocess.run([sys.executable, "-c", code], check=True, timeout=MOST)


def test_there_are_notebooks() -> None:
    assert len(NOTEBOOKS) >= 5
    assert SHORTEST in NOTEBOOKS


@pytest.mark.usefixtures("strict")
def test_the_shortest_runs(tmp_path: Path) -> None:
    notebook = nbformat.read(SHORTEST, as_version=4)  # type: ignore[no-untyped-call]
    assert faults(executed(notebook, tmp_path)) == []


@pytest.mark.usefixtures("strict")
def test_a_warning_ends_a_notebook(tmp_path: Path) -> None:
    with pytest.raises(CellExecutionError, match="too old"):
        executed(notebook_of("import warnings; warnings.warn('too old')"), tmp_path)


def test_the_site_executes_all_notebooks_and_fails_on_errors() -> None:
    """Check the settings of `make docs`."""
    text = (ROOT / "docs" / "conf.py").read_text(encoding="utf-8")
    assert 'nb_execution_mode = os.environ.get("NOTEBOOKS", "force")' in text
    assert "nb_execution_raise_on_error = True" in text
    assert "warnings_are_errors(" in text
    assert "check_built(" in text
    recipe = (ROOT / "Makefile").read_text(encoding="utf-8").partition("\ndocs:")[2].splitlines()[1]
    assert "sphinx -W -E" in recipe
    assert "NOTEBOOKS" not in recipe


def notebook_of(*sources: str) -> Any:
    cells = [nbformat.v4.new_code_cell(source) for source in sources]  # type: ignore[no-untyped-call]
    return nbformat.v4.new_notebook(cells=cells)  # type: ignore[no-untyped-call]


def with_outputs(*outputs: Any) -> Any:
    notebook = notebook_of("...")
    notebook.cells[0].outputs = [nbformat.from_dict(output) for output in outputs]  # type: ignore[no-untyped-call]
    return notebook


PICTURE = {"output_type": "display_data", "data": {"image/png": "..."}, "metadata": {}}


def stream_output(name: str, text: str) -> dict[str, Any]:
    return {"output_type": "stream", "name": name, "text": text}


@pytest.mark.parametrize(
    ("outputs", "expected"),
    [
        ([PICTURE, stream_output("stdout", "reached: True")], []),
        ([stream_output("stdout", "reached: True")], ["it shows no picture"]),
        ([PICTURE, stream_output("stdout", "reached: False")], ["a plan does not reach its target"]),
        ([PICTURE, stream_output("stdout", "Case 1 reached False")], ["a plan does not reach its target"]),
        ([PICTURE, stream_output("stderr", "Hm.\n")], ["it complains: Hm."]),
        (
            [PICTURE, {"output_type": "error", "ename": "KeyError", "evalue": "", "traceback": []}],
            ["it raises KeyError"],
        ),
    ],
)
def test_faults_are_found(outputs: list[Any], expected: list[str], tmp_path: Path) -> None:
    notebook = with_outputs(*outputs)
    assert faults(notebook) == expected
    for path in NOTEBOOKS:
        nbformat.write(notebook, tmp_path / path.name)  # type: ignore[no-untyped-call]
    if expected:
        with pytest.raises(RuntimeError, match=f"01-quickstart.ipynb: {expected[0]}"):
            check_built(tmp_path)
    else:
        check_built(tmp_path)
        (tmp_path / NOTEBOOKS[-1].name).unlink()
        with pytest.raises(RuntimeError, match=f"{NOTEBOOKS[-1].name}: it was not run"):
            check_built(tmp_path)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_kept_without_outputs(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)  # type: ignore[no-untyped-call]
    for cell in notebook.cells:
        if cell.cell_type == "code":
            assert cell.outputs == [], "strip the outputs"
            assert cell.execution_count is None


def test_external_scripts_are_found(tmp_path: Path) -> None:
    page = tmp_path / "sub" / "page.html"
    page.parent.mkdir()
    page.write_text('<script src="_static/a.js?v=1"></script> <a href="https://example.org/b.js">b</a>')
    check_offline(tmp_path)
    for address in ("https://example.org/b.js", "//example.org/b.js"):
        page.write_text(f'<script async="async" src="{address}"></script>')
        with pytest.raises(RuntimeError, match="example"):
            check_offline(tmp_path)
