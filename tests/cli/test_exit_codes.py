"""What the command line returns for an error of ours, and for a defect."""

from __future__ import annotations

from typing import Any

import pytest

from ffsms_pin.cli import info_command, main
from ffsms_pin.errors import InvalidValue


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (InvalidValue("dt", 0, "must be above zero"), 2, "ffsms-pin: error: dt must be above zero, got 0"),
        (KeyError("key"), 70, "a defect of this program, not of your input: KeyError"),
        (MemoryError(), 70, "MemoryError"),
    ],
)
def test_a_defect_is_told_from_bad_input_and_from_a_target_not_reached(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    error: Exception,
    code: int,
    words: str,
) -> None:
    def fail(arguments: Any) -> int:
        raise error

    monkeypatch.setattr(info_command, "run", fail)
    assert main(["info", "planar_3r"]) == code
    lines = capsys.readouterr().err.splitlines()
    assert words in lines[-1]
    assert (len(lines) == 1) == (code == 2)  # a defect shows where it is
