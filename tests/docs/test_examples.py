"""Each script of examples/ runs, arrives, and writes its scene."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

FOLDER = Path(__file__).parents[2] / "examples"
IN_BASILISK = "basilisk_orbit"
SCRIPTS = sorted(path for path in FOLDER.glob("*.py") if path.stem != IN_BASILISK)


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_it_runs_and_arrives(
    script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    names = runpy.run_path(str(script))
    assert "reached True" in capsys.readouterr().out
    assert names["track"].position_error[-1] < 2e-3
    assert (tmp_path / f"{script.stem}.html").is_file()


def test_the_flight_in_orbit_arrives_and_stays(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Twelve seconds of it: six to come there, six to stay while the client goes round."""
    script = str(FOLDER / f"{IN_BASILISK}.py")
    monkeypatch.setattr(sys, "argv", [script, "12"])
    names = runpy.run_path(script)
    assert "reached True" in capsys.readouterr().out
    late = names["late"]
    assert len(late) > 10
    assert max(late) < 1e-3
    # It was an orbit: in axes that do not turn, the fixture moved while the tool stayed at it.
    assert np.linalg.norm(names["fixture"](12.0) - names["fixture"](6.0)) > 5e-3
