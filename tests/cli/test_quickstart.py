"""`ffsms-pin quickstart`: the notebook that it writes runs, and replaces nothing."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pytest

from ffsms_pin.cli.main import main


def test_the_notebook_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    mpl.use("Agg")
    assert main(["quickstart"]) == 0
    nbformat: Any = pytest.importorskip("nbformat")
    nbformat.validate(nbformat.read(tmp_path / "quickstart.ipynb", as_version=4))
    cells = json.loads((tmp_path / "quickstart.ipynb").read_text())["cells"]
    names: dict[str, Any] = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            exec(cell["source"].replace("%matplotlib inline", ""), names)
    assert names["plan"].reached
    assert len(names["tracking"].t) > 1000


def test_nothing_is_replaced(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "mine.ipynb"
    path.write_text("mine")
    assert main(["quickstart", "--out", str(path)]) == 2
    assert "already" in capsys.readouterr().err
    assert path.read_text() == "mine"


@pytest.mark.parametrize("name", ["", " ", "no/such/folder/a.ipynb"])
def test_a_place_that_cannot_be_written(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["quickstart", "--out", name]) == 2
    assert "Traceback" not in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
