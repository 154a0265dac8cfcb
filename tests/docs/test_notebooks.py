"""Every notebook runs from top to bottom without a warning, and is kept without its outputs."""

from __future__ import annotations

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

_FOLDER = Path(__file__).parents[2] / "notebooks"
_NOTEBOOKS = sorted(_FOLDER.glob("*.ipynb"))
_MOST = 600  # [s] a cell that hangs; a notebook is meant to take less than a minute

_STRICT = "import warnings\nwarnings.simplefilter('error')"


def test_there_are_notebooks() -> None:
    assert len(_NOTEBOOKS) >= 5


@pytest.mark.parametrize("path", _NOTEBOOKS, ids=lambda path: path.stem)
# The kernel's sockets outlive the test by a moment.
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::DeprecationWarning")
def test_notebook_runs(path: Path, tmp_path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)  # type: ignore[no-untyped-call]
    strict = nbformat.v4.new_code_cell(_STRICT)  # type: ignore[no-untyped-call]
    notebook.cells.insert(0, strict)
    client = NotebookClient(
        notebook, timeout=_MOST, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    )
    client.execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    # Something is shown, and nothing is said that nobody meant to say.
    assert any(output.output_type in ("display_data", "execute_result") for output in outputs)
    said = [output.text for output in outputs if output.output_type == "stream" and output.name == "stderr"]
    assert said == []
    pictures = ("text/html", "image/png")
    assert any(kind in output.get("data", {}) for output in outputs for kind in pictures)
    # The prose counts on every plan to arrive.
    printed = "".join(output.text for output in outputs if output.output_type == "stream")
    assert "reached: False" not in printed
    assert "reached False" not in printed


@pytest.mark.parametrize("path", _NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_kept_without_outputs(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)  # type: ignore[no-untyped-call]
    for cell in notebook.cells:
        if cell.cell_type == "code":
            assert cell.outputs == [], "strip the outputs"
            assert cell.execution_count is None
