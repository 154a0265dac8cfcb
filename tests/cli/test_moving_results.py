"""The results folder under kills, links, full disks and strangers' files."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
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
from ffsms_pin.cli import output as module

if {move}:  # after so many files
    really, moved = module.replace_file, []
    def replace_file(source, path):
        if len(moved) == {move}:
            os.kill(os.getpid(), 9)
        moved.append(path)
        really(source, path)
    module.replace_file = replace_file
with module.results_folder(Path({out!r})) as staging:
    for name in "abc":
        (staging / name).write_text("new " + name)
    if not {move}:
        os.kill(os.getpid(), 9)
"""


def killed(out: Path, move: int) -> None:
    """A run killed before its results move, or after so many of three have moved."""
    code = KILLED.format(out=str(out), move=move)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=False, timeout=60)
    assert done.returncode == -9, done.stderr


def texts(out: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in out.iterdir() if path.is_file()}


@pytest.mark.parametrize("there", [False, True])
def test_what_a_killed_run_left_half_written_goes_with_the_next(tmp_path: Path, there: bool) -> None:
    out = tmp_path / "out"
    if there:
        out.mkdir()
        (out / "a").write_text("old")
    home = out if there else tmp_path
    for name in (".out.deadbeef", ".out.ffsms-pin-mine"):  # a stranger's, with names like ours
        (home / name).mkdir()
        (home / name / "a").write_text("mine")
    foreign = set(os.listdir(home))
    killed(out, 0)
    assert len(set(os.listdir(home)) - foreign) == 1
    assert not there or texts(out) == {"a": "old"}
    with results_folder(out) as staging:
        assert set(os.listdir(home)) - foreign == {staging.name}
        (staging / "b").write_text("newer")
    assert set(os.listdir(home)) - foreign == {"b" if there else "out"}
    assert texts(out) == ({"a": "old", "b": "newer"} if there else {"b": "newer"})


def test_a_folder_in_use_is_not_a_leftover(tmp_path: Path) -> None:
    with results_folder(tmp_path / "out") as first:
        (first / "a").write_text("first")
        with results_folder(tmp_path / "out") as second:
            (second / "b").write_text("second")
        assert (first / "a").read_text() == "first"
    assert texts(tmp_path / "out") == {"a": "first", "b": "second"}
    assert os.listdir(tmp_path) == ["out"]
    assert sorted(os.listdir(tmp_path / "out")) == ["a", "b"]


@pytest.mark.parametrize("move", [1, 2])
def test_a_move_that_was_killed_is_finished_by_the_next_run(tmp_path: Path, move: int) -> None:
    out = tmp_path / "out"
    out.mkdir()
    for name in "abcd":
        (out / name).write_text("old")
    killed(out, move)
    found = texts(out)
    assert sorted(found.values()) == ["new a", "new b", "new c"][:move] + ["old"] * (4 - move)

    def fail() -> None:  # even a run that comes to nothing
        with results_folder(out):
            assert texts(out) == {"a": "new a", "b": "new b", "c": "new c", "d": "old"}
            raise RuntimeError("stopped")

    with pytest.raises(RuntimeError, match="stopped"):
        fail()
    assert sorted(os.listdir(out)) == ["a", "b", "c", "d"]


def test_links_stay_and_modes_are_kept(tmp_path: Path) -> None:
    out, far = tmp_path / "out", tmp_path / "far"
    out.mkdir()
    far.write_text("old")
    far.chmod(0o600)
    (out / "a").symlink_to(far)
    with results_folder(out) as staging:
        (staging / "a").write_text("new")
    assert os.readlink(out / "a") == str(far)
    assert far.read_text() == "new"
    assert far.stat().st_mode & 0o777 == 0o600


def test_a_link_to_another_file_system(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out, far = tmp_path / "out", tmp_path / "far"
    out.mkdir()
    far.write_text("old")
    (out / "a").symlink_to(far)
    really = os.replace

    def replace(source: Any, target: Any) -> None:
        if Path(source).parent != Path(target).parent:
            raise OSError(18, "Invalid cross-device link")
        really(source, target)

    monkeypatch.setattr(os, "replace", replace)
    with results_folder(out) as staging:
        (staging / "a").write_text("new")
    assert far.read_text() == "new"
    assert os.listdir(out) == ["a"]


def test_a_link_to_a_folder_that_is_not_there_yet(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to("real")
    with results_folder(tmp_path / "link") as staging:
        (staging / "a").write_text("1")
    assert (tmp_path / "link").is_symlink()
    assert texts(tmp_path / "real") == {"a": "1"}


def test_nothing_moves_where_something_cannot(tmp_path: Path) -> None:
    out = tmp_path / "out"
    (out / "b").mkdir(parents=True)
    (out / "a").write_text("old")

    def fill() -> None:
        with results_folder(out) as staging:
            for name in "ab":
                (staging / name).write_text("new")

    with pytest.raises(ResultError, match=r"out/b: is a folder; results are written to regular files only"):
        fill()
    assert texts(out) == {"a": "old"}
    assert sorted(os.listdir(out)) == ["a", "b"]


def test_a_move_that_fails_half_way_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "out"
    out.mkdir()

    def fill() -> None:
        with results_folder(out) as staging:
            for name in "ab":
                (staging / name).write_text("new")

    really = files.replace_file

    def full(source: Path, path: Path) -> None:
        if path.name == "b":
            raise OSError(28, "No space left on device")
        really(source, path)

    monkeypatch.setattr(module, "replace_file", full)
    with pytest.raises(
        ResultError, match=r"No space left.*the rest is in .*-complete: the next run moves it"
    ):
        fill()
    monkeypatch.undo()
    assert texts(out) == {"a": "new"}
    with results_folder(out):
        pass
    assert texts(out) == {"a": "new", "b": "new"}
    assert sorted(os.listdir(out)) == ["a", "b"]


def test_a_full_disk_is_found_out_before_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "a").write_text("old")
    room = shutil._ntuple_diskusage(10**9, 10**9 - 1000, 1000)
    monkeypatch.setattr(shutil, "disk_usage", lambda place: room)
    for out in (tmp_path / "out", tmp_path / "new" / "out"):
        with (
            pytest.raises(ResultError, match=r"needs about 16 MB.*only 0\.001 MB are free"),
            results_folder(out),
        ):
            pytest.fail("the run has begun")
    assert os.listdir(tmp_path) == ["out"]
    assert texts(tmp_path / "out") == {"a": "old"}
