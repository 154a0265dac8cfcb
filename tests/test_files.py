"""Test that files are written completely or not at all, through links, and keep their permissions."""

from __future__ import annotations

import os
import signal
import socket
import stat
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO

import pytest

from ffsms_pin.errors import FfsmsError, ResultError
from ffsms_pin.files import write_atomically, write_content

Refused = Callable[..., FfsmsError]


@pytest.fixture(autouse=True)
def umask() -> Iterator[None]:
    before = os.umask(0o027)
    yield
    os.umask(before)


def mode(path: Path) -> int:
    """Return the permissions of a file."""
    return stat.S_IMODE(path.stat().st_mode)


def test_a_link_stays_and_its_file_is_written(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    file, link, far = tmp_path / "there" / "file", tmp_path / "link", tmp_path / "far"
    file.write_text("old")
    link.symlink_to("there/file")
    far.symlink_to(link)
    write_content(far, "new")
    assert file.read_text() == "new"
    assert os.readlink(link) == "there/file"
    assert far.is_symlink()
    # A link to a file that does not exist yet.
    (tmp_path / "dangling").symlink_to("there/other")
    write_content(tmp_path / "dangling", "made")
    assert (tmp_path / "there" / "other").read_text() == "made"
    assert sorted(os.listdir(tmp_path)) == ["dangling", "far", "link", "there"]


def test_the_mode_is_kept_and_a_new_file_gets_the_umask(tmp_path: Path) -> None:
    new, private = tmp_path / "new", tmp_path / "private"
    write_content(new, "1")
    assert mode(new) == 0o640
    private.write_text("old")
    private.chmod(0o600)

    def write(file: IO[bytes]) -> None:
        # The temporary file must not be readable by others.
        assert {mode(path) for path in tmp_path.glob(".private*")} == {0o600}
        file.write(b"secret")

    write_atomically(private, write)
    assert mode(private) == 0o600
    assert private.read_text() == "secret"


def test_only_regular_files_are_overwritten(tmp_path: Path, refused: Refused) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "null").symlink_to("/dev/null")
    server = socket.socket(socket.AF_UNIX)
    server.bind(str(tmp_path / "socket"))
    for name, word in {
        "pipe": "is a pipe",
        "folder": "is a folder",
        "null": "is a device",
        "socket": "is a socket",
    }.items():
        path = tmp_path / name
        before = path.lstat()
        refused(lambda path=path: write_content(path, "x"), ResultError, name, word, "regular files only")
        assert path.lstat() == before
    server.close()
    assert not stat.S_ISREG(os.stat("/dev/null").st_mode)
    refused(lambda: write_content(tmp_path / "none" / "x", "x"), ResultError, "cannot be written")
    assert len(os.listdir(tmp_path)) == 4


KILLED = """
import os
from ffsms_pin.files import write_atomically
def write(file):
    file.write(b"half")
    file.flush()
    os.kill(os.getpid(), 9)
write_atomically({path!r}, write)
"""


def test_a_writer_that_is_killed_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "x.npz"
    path.write_text("old")
    killed = subprocess.run([sys.executable, "-c", KILLED.format(path=str(path))], check=False)
    assert killed.returncode == -signal.SIGKILL
    assert path.read_text() == "old"
    write_content(path, "new")
    assert path.read_text() == "new"


def test_a_file_with_the_longest_name_is_written(tmp_path: Path) -> None:
    write_content(tmp_path / ("ü" * 127), "x")
    assert len(os.listdir(tmp_path)) == 1


def test_a_writer_that_fails_leaves_everything_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_text("old")
    started = time.time()
    os.utime(path, (started - 100.0, started - 100.0))
    before = path.stat()

    def full(file: IO[bytes]) -> None:
        file.write(b"half")
        raise OSError(28, "No space left on device")

    with pytest.raises(ResultError, match="No space left"):
        write_atomically(path, full)
    assert path.stat() == before
    assert os.listdir(tmp_path) == ["x"]
