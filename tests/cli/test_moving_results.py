"""Test the results folder after kills and failures, with links, and with existing files."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ffsms_pin import files
from ffsms_pin.cli import output as module
from ffsms_pin.cli.output import results_folder
from ffsms_pin.errors import ResultError

KILLED = """
import os
from pathlib import Path
from ffsms_pin import files
from ffsms_pin.cli import output as module

if {move}:  # kill the process after this number of files
    move, moved = module.write_atomically, []
    def write_atomically(path, write):
        if len(moved) == {move}:
            os.kill(os.getpid(), 9)
        moved.append(path)
        move(path, write)
    module.write_atomically = write_atomically
with module.results_folder(Path({out!r})) as staging:
    for name in "abc":
        (staging / name).write_text("new " + name)
    if not {move}:
        os.kill(os.getpid(), 9)
"""


def killed(out: Path, move: int) -> None:
    """Run a process that is killed after `move` of its three results have been moved."""
    code = KILLED.format(out=str(out), move=move)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False, timeout=60)
    assert done.returncode == -9, done.stderr


def texts(out: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in out.iterdir() if path.is_file()}


def fill(out: Path, names: str = "ab") -> None:
    """Write one result file for each letter."""
    with results_folder(out) as staging:
        for name in names:
            (staging / name).write_text("new")


def test_a_killed_run_leaves_earlier_results_and_the_next_run_replaces_them(tmp_path: Path) -> None:
    out = tmp_path / "out"
    killed(out, 0)
    assert texts(out) == {}
    (out / "a").write_text("old")
    killed(out, 0)
    assert texts(out) == {"a": "old"}
    fill(out)
    assert texts(out) == {"a": "new", "b": "new"}


@pytest.mark.parametrize("move", [1, 2])
def test_a_run_killed_while_its_results_move_leaves_every_file_whole(tmp_path: Path, move: int) -> None:
    out = tmp_path / "out"
    out.mkdir()
    for name in "abcd":
        (out / name).write_text("old")
    killed(out, move)
    assert sorted(texts(out).values()) == ["new a", "new b", "new c"][:move] + ["old"] * (4 - move)
    (staging,) = [path for path in out.iterdir() if path.is_dir()]
    assert texts(staging) == {name: f"new {name}" for name in "abc"}  # nothing is lost


def test_two_runs_into_one_folder(tmp_path: Path) -> None:
    with results_folder(tmp_path / "out") as first:
        (first / "a").write_text("first")
        with results_folder(tmp_path / "out") as second:
            (second / "b").write_text("second")
        assert (first / "a").read_text() == "first"
    assert texts(tmp_path / "out") == {"a": "first", "b": "second"}
    assert os.listdir(tmp_path) == ["out"]
    assert sorted(os.listdir(tmp_path / "out")) == ["a", "b"]


def test_links_stay_and_modes_are_kept(tmp_path: Path) -> None:
    out, far = tmp_path / "out", tmp_path / "far"
    out.mkdir()
    far.write_text("old")
    far.chmod(0o600)
    (out / "a").symlink_to(far)
    fill(out)
    assert os.readlink(out / "a") == str(far)
    assert far.read_text() == "new"
    assert far.stat().st_mode & 0o777 == 0o600


def test_a_link_to_a_folder_that_is_not_there_yet(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to("real")
    fill(tmp_path / "link", "a")
    assert (tmp_path / "link").is_symlink()
    assert texts(tmp_path / "real") == {"a": "new"}


def test_no_result_moves_if_one_of_them_cannot(tmp_path: Path) -> None:
    out = tmp_path / "out"
    (out / "b").mkdir(parents=True)
    (out / "a").write_text("old")
    with pytest.raises(ResultError, match=r"out/b: is a folder.*kept in .*out/\.out") as caught:
        fill(out)
    assert texts(out) == {"a": "old"}
    assert texts(Path(str(caught.value).rpartition(" ")[2])) == {"a": "new", "b": "new"}


def test_a_move_that_fails_keeps_all_results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "out"
    out.mkdir()
    write_atomically = files.write_atomically

    def full(path: Path, write: Callable[[Any], object]) -> None:
        if path.name == "b":
            raise OSError(28, "No space left on device")
        write_atomically(path, write)

    monkeypatch.setattr(module, "write_atomically", full)
    with pytest.raises(ResultError, match=r"No space left") as caught:
        fill(out)
    assert texts(out) == {"a": "new"}
    assert texts(Path(str(caught.value).rpartition(" ")[2])) == {"a": "new", "b": "new"}


def test_an_out_that_is_a_file_or_cannot_be_created_is_refused(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("mine")
    with pytest.raises(ResultError, match="is a file, but the results need a folder; choose another --out"):
        fill(tmp_path / "out")
    with pytest.raises(ResultError, match="cannot be written"):
        fill(tmp_path / "out" / "below")
    assert texts(tmp_path) == {"out": "mine"}
