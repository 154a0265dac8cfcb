"""Run the code of docs/bases-that-act.md, and check its statements."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from condition_files import QUICK
from page_code import run_page, shown

from ffsms_pin.scenarios import scenario

PAGE = Path(__file__).parents[2] / "docs" / "bases-that-act.md"
TABLES = re.compile(r"^```toml\n(.*?)^```$", re.S | re.M)


@pytest.mark.slow
@pytest.mark.long
def test_the_examples_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Run all blocks in order, because the second block uses names of the first."""
    names = run_page(PAGE, tmp_path)
    assert set(shown(PAGE)) <= {path.name for path in tmp_path.iterdir()}
    track, plan = names["track"], names["plan"]
    assert plan.reached
    assert track.note == ""
    assert np.abs(track.q[:, 3:6] - track.q[0, 3:6]).max() < 1e-5
    again, first = names["again"], names["q0"][3:6]
    assert again.position_error[-1] < 5e-4
    assert np.degrees(2.0 * np.abs(again.q[:, 3:6] - first).max()) < 0.1
    assert capsys.readouterr().out


def test_the_tables_can_be_read(tmp_path: Path) -> None:
    (text,) = TABLES.findall(PAGE.read_text(encoding="utf-8"))
    path = tmp_path / "mine.toml"
    path.write_text(QUICK[: QUICK.index("[control]")] + text, encoding="utf-8")
    sms = scenario(path).load()
    assert sms.wheels is not None
    np.testing.assert_array_equal(sms.wheels.momentum, [12.0, 12.0, 12.0])
