"""Results are written to regular files: through links, with the mode that is there, leftovers removed."""

from __future__ import annotations

import os
import shutil
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
from ffsms_pin.storage import remove_leftovers, require_space, write_atomically, write_content

Refused = Callable[..., FfsmsError]


@pytest.fixture(autouse=True)
def umask() -> Iterator[None]:
    before = os.umask(0o027)
    yield
    os.umask(before)


def mode(path: Path) -> int:
    """Permissions of a file."""
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
    # A link to a file that is not there yet.
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
        # Nobody else may read it meanwhile either.
        assert {mode(path) for path in tmp_path.glob(".private*")} == {0o600}
        file.write(b"secret")

    write_atomically(private, write)
    assert mode(private) == 0o600
    assert private.read_text() == "secret"


def test_what_is_no_regular_file_is_refused(tmp_path: Path, refused: Refused) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "null").symlink_to("/dev/null")
    server = socket.socket(socket.AF_UNIX)
    server.bind(str(tmp_path / "socket"))
    for name, word in {
        "pipe": "is a pipe",
        "folder": "is a folder",
        "loop": "is a link that leads to itself",
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
    assert len(os.listdir(tmp_path)) == 5


KILLED = """
import os
from ffsms_pin.storage import write_atomically
def write(file):
    file.write(b"half")
    file.flush()
    print("half", flush=True)
    {then}
write_atomically({path!r}, write)
"""


def writer(path: Path, then: str) -> subprocess.Popen[str]:
    """A process that has written half of a file."""
    code = KILLED.format(path=str(path), then=then)
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "half\n"
    return process


def test_the_next_writer_removes_what_a_dead_one_left(tmp_path: Path) -> None:
    path = tmp_path / "x.npz"
    path.write_text("old")
    dead = writer(path, "os.kill(os.getpid(), 9)")
    dead.communicate(timeout=60)
    assert dead.returncode == -signal.SIGKILL
    (left,) = tmp_path.glob(".x.npz.*")
    assert path.read_text() == "old"
    alive = writer(path, "import time; time.sleep(600)")
    try:
        (busy,) = set(tmp_path.glob(".x.npz.*"))  # the writer has removed the dead one's already
        assert busy != left
        # Names like ours, and a pipe and a link that have one: not ours.
        (tmp_path / ".x.npz.deadbeef").write_text("mine")
        (tmp_path / ".x.npz.ffsms-pin-mine").write_text("mine")
        os.mkfifo(tmp_path / ".x.npz.ffsms-pin-00000000")
        (tmp_path / ".x.npz.ffsms-pin-00000001").symlink_to(path)
        foreign = set(os.listdir(tmp_path))
        write_content(path, "new")
        assert set(os.listdir(tmp_path)) == foreign  # and what lives is left alone
        assert path.read_text() == "new"
    finally:
        alive.kill()
        alive.communicate(timeout=60)
    remove_leftovers(tmp_path)
    assert set(os.listdir(tmp_path)) == foreign - {busy.name}


def test_a_name_as_long_as_it_may_be(tmp_path: Path) -> None:
    write_content(tmp_path / ("ü" * 127), "x")
    assert len(os.listdir(tmp_path)) == 1


def test_space_is_asked_for_in_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    require_space(tmp_path / "not" / "there" / "yet", 1.0)
    with pytest.raises(ResultError, match=r"needs about 1e\+12 GB, but only .* are free\); make room"):
        require_space(tmp_path / "x", 1e21)

    def silent(place: object) -> None:
        raise OSError(38, "Function not implemented")

    monkeypatch.setattr(shutil, "disk_usage", silent)
    require_space(tmp_path, 1e21)  # nobody knows


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
