"""Writing to regular files: whole or not at all, through links, with the mode that the file has."""

from __future__ import annotations

import errno
import os
import shutil
import stat
from collections.abc import Callable
from pathlib import Path
from typing import IO

from ffsms_pin.errors import ResultError
from ffsms_pin.storage.paths import KINDS, path_like
from ffsms_pin.storage.temporary import locked_file, remove_leftovers

__all__ = [
    "check_writable",
    "regular_target",
    "replace_file",
    "require_space",
    "write_atomically",
    "write_content",
]


def regular_target(path: str | os.PathLike[str]) -> Path:
    """The file that a path leads to, through links, or will; `ResultError` where something else is there."""
    target = Path(os.path.realpath(path_like("path", path)))
    try:
        kind = stat.S_IFMT(target.lstat().st_mode)
    except (FileNotFoundError, NotADirectoryError):
        return target
    except OSError as error:
        raise ResultError(path, f"cannot be written ({error.strerror})") from None
    if kind != stat.S_IFREG:
        what = KINDS.get(kind, "no regular file")
        raise ResultError(
            path, f"is {what}; results are written to regular files only, so choose another name"
        )
    return target


def write_atomically(
    path: str | os.PathLike[str], write: Callable[[IO[bytes]], None], durable: bool = False
) -> None:
    """Write a file so that it is there whole or not at all.

    `write` is given an open binary file, in the same folder, that takes the name at the end. A link is
    followed and stays. A file that is replaced keeps its mode, and stays as it was where `ResultError` says
    that it cannot be written. Where it is `durable`, the disk has the file, and then its name, at the end.
    """
    target = regular_target(path)
    remove_leftovers(target.parent)
    try:
        temporary, handle = locked_file(target.parent, target.name)
    except OSError as error:
        raise ResultError(path, f"cannot be written ({error.strerror})") from None
    try:
        with os.fdopen(handle, "wb") as file:
            _keep_mode(target, temporary)
            write(file)
            file.flush()
            if durable:
                os.fsync(file.fileno())
            os.replace(temporary, target)  # while the lock is held
        if durable and os.name == "posix":
            _sync_folder(target.parent)
    except BaseException as error:
        temporary.unlink(missing_ok=True)
        if isinstance(error, OSError) and not isinstance(error, ResultError):  # one of another file stays
            raise ResultError(path, f"cannot be written ({error.strerror})") from None
        raise


def _sync_folder(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_content(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Write a text, in UTF-8, or bytes to a file that is there whole or not at all."""
    raw = content.encode() if isinstance(content, str) else content

    def write(file: IO[bytes]) -> None:
        file.write(raw)

    write_atomically(path, write)


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
    try:
        temporary, handle = locked_file(target.parent, target.name)
        os.close(handle)
        temporary.unlink(missing_ok=True)
    except OSError as error:
        raise ResultError(path, f"cannot be written ({error.strerror})") from None
    return target


def require_space(path: str | os.PathLike[str], size: float) -> None:
    """Raise `ResultError` unless there are `size` bytes free where `path`, or a folder of it, is to be."""
    place = Path(os.path.realpath(path))
    while not place.exists() and place != place.parent:
        place = place.parent
    try:
        free = shutil.disk_usage(place).free
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
    try:
        mode = stat.S_IMODE(target.stat().st_mode)
    except FileNotFoundError:
        return
    os.chmod(temporary, mode)


def _megabytes(size: float) -> str:
    return f"{size / 1e6:.3g} MB" if size < 1e9 else f"{size / 1e9:.3g} GB"
