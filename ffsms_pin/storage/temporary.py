"""Hidden files and folders that hold what is half written, and their removal once their run is dead.

Their name says that they are ours: `.NAME.ffsms-pin-xxxxxxxx`. The run that made one holds a lock on it
(flock) that the system releases when the run ends, however it ends. One without a lock is a leftover.
"""

from __future__ import annotations

import fcntl  # of POSIX systems: those that Pinocchio is packaged for
import os
import re
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

__all__ = [
    "COMPLETE",
    "hidden_path",
    "is_abandoned",
    "locked_file",
    "locked_folder",
    "open_folder",
    "remove_leftovers",
    "staged_folder",
]

COMPLETE = "-complete"  # ends the name of a folder whose files only have to be moved: no leftover to remove
_OURS = re.compile(r"\..*\.ffsms-pin-[0-9a-f]{8}", re.DOTALL)


def hidden_path(folder: Path, name: str) -> Path:
    """A path for something half written, in `folder`, that will be `name`."""
    # No more of the name than 40 characters: file systems take 255 bytes.
    return folder / f".{name[:40]}.ffsms-pin-{secrets.token_hex(4)}"


def locked_file(folder: Path, name: str) -> tuple[Path, int]:
    """A new hidden file and its descriptor, open for writing; its mode is what the umask leaves."""
    while True:
        path = hidden_path(folder, name)
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
        if _held(path, handle):
            return path, handle


def locked_folder(folder: Path, name: str) -> tuple[Path, int]:
    """A new hidden folder, and the descriptor to close when it has been moved or removed."""
    while True:
        path = hidden_path(folder, name)
        path.mkdir()
        handle = open_folder(path)
        if _held(path, handle):
            return path, handle


@contextmanager
def staged_folder(folder: Path, name: str) -> Iterator[Path]:
    """A new hidden folder for the time of the block: what is to stay is moved out of it."""
    path, handle = locked_folder(folder, name)
    try:
        yield path
    finally:
        shutil.rmtree(path, ignore_errors=True)
        os.close(handle)


def open_folder(path: Path) -> int:
    """A descriptor to lock a folder by; a link to a folder is none."""
    return os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)


def is_abandoned(handle: int) -> bool:
    """Whether no run holds the lock of an open file or folder; if so, the descriptor holds it from now on."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:  # held by a run, or there are no locks on this file system and nobody knows
        return False
    return True


def remove_leftovers(folder: Path) -> None:
    """Remove what dead runs left half written in a folder; errors are no matter, the next run tries again."""
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            plain = entry.is_file(follow_symlinks=False) or entry.is_dir(follow_symlinks=False)
            if plain and _OURS.fullmatch(entry.name):
                with suppress(OSError):
                    _remove_abandoned(Path(entry.path))


def _remove_abandoned(path: Path) -> None:
    handle = open_folder(path)
    try:
        if is_abandoned(handle):
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink()
    finally:
        os.close(handle)


def _held(path: Path, handle: int) -> bool:
    """Lock what was just made; False where another run took it for a leftover before the lock was there."""
    with suppress(OSError):
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    try:
        there = os.path.samestat(os.stat(path), os.fstat(handle))
    except FileNotFoundError:
        there = False
    if not there:
        os.close(handle)
    return there
