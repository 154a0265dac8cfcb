"""Each script of examples/ runs, arrives, and writes its scene."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

SCRIPTS = sorted((Path(__file__).parents[2] / "examples").glob("*.py"))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_it_runs_and_arrives(
    script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    names = runpy.run_path(str(script))
    assert "reached True" in capsys.readouterr().out
    assert names["track"].position_error[-1] < 2e-3
    assert (tmp_path / f"{script.stem}.html").is_file()
