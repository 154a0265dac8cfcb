"""Files: only regular ones are read, and none that is absurdly large; they are written whole or not at all.

What is half written is hidden, and removed once its run is dead.
"""

from __future__ import annotations

import errno
import fcntl  # of POSIX systems: those that Pinocchio is packaged for
import os
import re
import secrets
import shutil
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

from ffsms_pin.errors import InvalidValue, ResultError

_LONGEST_NAME = 255  # [bytes] of one part of a path, what file systems take
LARGEST_TEXT = 2**26  # [bytes] of a robot, a scenario or a summary: hundreds of times what any of them takes
LARGEST_DATA = 2**31  # [bytes] of a table or a mesh: an hour at 1 kHz is as long in CSV
_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
    stat.S_IFLNK: "a link that leads to itself",
}


def path_like(name: str, value: Any) -> Path:
    """A path; `InvalidValue` says that an argument is none, or one that no system takes."""
    try:
        path = os.fspath(value)
        if not isinstance(path, str) or not path or "\0" in path:
            raise TypeError
        if any(len(part) > _LONGEST_NAME for part in os.fsencode(path).split(b"/")):
            raise TypeError
    except (TypeError, UnicodeEncodeError):
        raise InvalidValue(name, value, "must be a path") from None
    return Path(path)


def _kind(found: os.stat_result) -> str:
    """What is there, in words."""
    return _KINDS.get(stat.S_IFMT(found.st_mode), "something else")


def check_readable(path: str | os.PathLike[str], largest: float = LARGEST_TEXT) -> None:
    """Raise an OSError in words unless a path leads to a regular file of at most `largest` bytes.

    A device may have no end, and whoever opens a pipe waits for its other end.
    """
    found = os.stat(path)
    if not stat.S_ISREG(found.st_mode):
        raise OSError(errno.EINVAL, f"it is no regular file but {_kind(found)}")
    if found.st_size > largest:
        much = f"it holds {found.st_size / 1e6:.4g} MB, and at most {largest / 1e6:.4g} MB are read"
        raise OSError(errno.EFBIG, much)


def read_content(path: str | os.PathLike[str], largest: int = LARGEST_TEXT) -> bytes:
    """What a file holds; errors as of `check_readable`."""
    check_readable(path, largest)
    with open(path, "rb") as file:
        return file.read(min(largest, os.fstat(file.fileno()).st_size))  # more is taken as memory at once


@contextmanager
def told(path: str | os.PathLike[str], done: str = "written") -> Iterator[None]:
    """Errors of the system inside it as a `ResultError`, which says that `path` cannot be `done`."""
    try:
        yield
    except ResultError:  # itself an OSError: what is said of another file stays
        raise
    except OSError as error:
        missing = done == "read" and isinstance(error, FileNotFoundError)
        words = "there is no such file" if missing else f"cannot be {done} ({error.strerror or error})"
        raise ResultError(path, words) from None


COMPLETE = "-complete"  # ends the name of a folder whose files only have to be moved: no leftover to remove
_OURS = re.compile(r"\..*\.ffsms-pin-[0-9a-f]{8}", re.DOTALL)


def regular_target(path: str | os.PathLike[str]) -> Path:
    """The file that a path leads to, through links, or will; `ResultError` where something else is there."""
    target = Path(os.path.realpath(path_like("path", path)))
    with told(path), suppress(FileNotFoundError, NotADirectoryError):
        found = target.lstat()
        if not stat.S_ISREG(found.st_mode):
            words = f"is {_kind(found)}; results are written to regular files only, so choose another name"
            raise ResultError(path, words)
    return target


def write_atomically(
    path: str | os.PathLike[str], write: Callable[[IO[bytes]], object], durable: bool = False
) -> None:
    """Write a file so that it is there whole or not at all.

    `write` is given an open binary file, in the same folder, that takes the name at the end. A link is
    followed and stays. A file that is replaced keeps its mode, and stays as it was where `ResultError` says
    that it cannot be written. Where it is `durable`, the disk has the file, and then its name, at the end.
    """
    target = regular_target(path)
    remove_leftovers(target.parent)
    with told(path), _beside(target) as (temporary, handle), os.fdopen(handle, "wb") as file:
        _keep_mode(target, temporary)
        write(file)
        file.flush()
        if durable:
            os.fsync(file.fileno())
        os.replace(temporary, target)  # while the lock is held
        if durable:
            folder = open_folder(target.parent)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)


@contextmanager
def _beside(target: Path) -> Iterator[tuple[Path, int]]:
    """A hidden file beside another one, and its descriptor; it is gone at the end unless it was moved."""
    path, handle = locked_file(target.parent, target.name)
    try:
        yield path, handle
    finally:
        path.unlink(missing_ok=True)


def write_content(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Write a text, in UTF-8, or bytes to a file that is there whole or not at all."""
    raw = content.encode() if isinstance(content, str) else content
    write_atomically(path, lambda file: file.write(raw))


def replace_file(source: Path, path: Path) -> None:
    """Move a finished file to a place, under the same rules as `write_atomically`."""
    target = regular_target(path)
    _keep_mode(target, source)
    try:
        os.replace(source, target)
    except OSError as error:
        if error.errno != errno.EXDEV:  # a link may lead to another file system
            raise
        with source.open("rb") as finished:
            write_atomically(target, lambda file: shutil.copyfileobj(finished, file))
        source.unlink()


def check_writable(path: str | os.PathLike[str]) -> Path:
    """The file that a path leads to; `ResultError` before a long run where it cannot be written."""
    target = regular_target(path)
    with told(path), _beside(target) as (_, handle):
        os.close(handle)
    return target


def require_space(path: str | os.PathLike[str], size: float) -> None:
    """Raise `ResultError` unless there are `size` bytes free where `path`, or a folder of it, is to be."""
    place = Path(os.path.realpath(path))
    try:
        free = shutil.disk_usage(next(one for one in (place, *place.parents) if one.exists())).free
    except OSError:  # a file system that does not say
        return
    if free < size:
        raise ResultError(
            path,
            f"cannot be written (it needs about {_megabytes(size)}, but only {_megabytes(free)} are free); "
            "make room, or choose another place",
        )


def _keep_mode(target: Path, temporary: Path) -> None:
    """Give a file the mode of the one that it replaces."""
    with suppress(FileNotFoundError):
        shutil.copymode(target, temporary)


def _megabytes(size: float) -> str:
    return f"{size / 1e6:.3g} MB" if size < 1e9 else f"{size / 1e9:.3g} GB"


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
    is_abandoned(handle)
    with suppress(FileNotFoundError):
        if os.path.samestat(os.stat(path), os.fstat(handle)):
            return True
    os.close(handle)
    return False
