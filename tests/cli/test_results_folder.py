"""Test that a results folder is filled completely or not at all, and that progress is shown."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from rich.console import Console

from ffsms_pin.cli.output import results_folder, shown_progress
from ffsms_pin.errors import ResultError


@pytest.mark.parametrize("there", [False, True])
def test_a_failure_leaves_the_folder_as_it_was(tmp_path: Path, there: bool) -> None:
    out = tmp_path / "a" / "b" / "out"
    if there:
        out.mkdir(parents=True)
        (out / "old.txt").write_text("old")
    before = sorted(tmp_path.rglob("*"))

    def fill() -> None:
        with results_folder(out) as staging:
            (staging / "old.txt").write_text("new")
            raise RuntimeError("stopped")

    with pytest.raises(RuntimeError, match="stopped"):
        fill()
    assert sorted(tmp_path.rglob("*")) == before
    if there:
        assert (out / "old.txt").read_text() == "old"


def test_a_full_disk_is_a_library_error(tmp_path: Path) -> None:
    def fill() -> None:
        with results_folder(tmp_path / "out"):
            raise OSError(28, "No space left on device")

    with pytest.raises(ResultError, match=r"out: cannot be written \(No space left on device\)"):
        fill()
    assert list(tmp_path.iterdir()) == []


def test_a_folder_through_a_link_is_filled_where_it_is(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real", target_is_directory=True)
    with results_folder(tmp_path / "link") as staging:
        (staging / "a").write_text("1")
    assert (tmp_path / "link").is_symlink()
    assert [path.name for path in (tmp_path / "real").iterdir()] == ["a"]


def test_a_terminal_gets_bars() -> None:
    console = Console(force_terminal=True, record=True, width=80, file=open(os.devnull, "w"))  # noqa: SIM115
    with shown_progress(console) as progress:
        for stage in ("planning", "tracking"):
            for share in (0.0, 0.5, 1.0):
                progress(stage, share)
    console.file.close()
    text = console.export_text()
    assert "planning" in text
    assert "100%" in text
