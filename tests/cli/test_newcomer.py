"""Test the errors of mistyped commands, arguments and names."""

from __future__ import annotations

from pathlib import Path

import pytest

from ffsms_pin.cli import main


def error_line(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Run a command that fails, and return its one-line error."""
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert error.startswith("ffsms-pin: error: ")
    return error


@pytest.mark.parametrize(
    ("arguments", "fragment"),
    [
        ((), "name a command, for example: ffsms-pin run case-2 (see ffsms-pin --help)"),
        (("rnu", "case-2"), "there is no command 'rnu'; did you mean 'run'?"),
        (("fly",), "there is no command 'fly'; the commands are run, "),
        (
            ("run", "case-2", "--ouut", "x"),
            "unknown argument '--ouut'; did you mean '--out'? (see ffsms-pin run",
        ),
        (("run", "case-2", "--figures=no"), "unknown argument '--figures=no'; did you mean '--no-figures'?"),
        (("run", "case-1", "case-2"), "unknown argument 'case-2' (see ffsms-pin run --help)"),
        (("run", "case-2", "--no-open"), "unknown argument '--no-open' (see ffsms-pin run --help)"),
        (("run", "csae-2"), "did you mean 'case-2'?"),
        (("info", "satelite_ur5"), "did you mean 'satellite_ur5'?"),
        (("campaign", "."), "is no results folder of a campaign (no campaign.json)"),
        (("view", "nowhere"), "nowhere: is not a folder of results; make one with `ffsms-pin run`"),
        (("view", "."), "holds no results of `ffsms-pin run` (no trajectory.npz)"),
    ],
)
def test_errors_suggest_a_correction(
    arguments: tuple[str, ...],
    fragment: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert fragment in error_line(capsys, *arguments)
    assert list(tmp_path.iterdir()) == []


def test_info_has_a_unit_for_every_number(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "160")  # wide enough for one line a row
    assert main(["info", "planar_3r"]) == 0
    out = capsys.readouterr().out
    for column in ("mass [kg]", "principal inertias [kg m²]"):
        assert column in out
    rows = [line for line in out.partition("quantity")[2].splitlines() if line.startswith("│")]
    assert len(rows) == 7
    assert all("[" in line.split("│")[1] for line in rows)
