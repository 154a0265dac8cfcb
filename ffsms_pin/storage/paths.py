"""Paths as arguments, and the files there: only regular ones are read, and none that is absurdly large."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import Any

from ffsms_pin.errors import InvalidValue

_LONGEST_NAME = 255  # [bytes] of one part of a path, what file systems take
LARGEST_TEXT = 2**26  # [bytes] of a robot, a scenario or a summary: hundreds of times what any of them takes
LARGEST_DATA = 2**31  # [bytes] of a table or a mesh: an hour at 1 kHz is as long in CSV
KINDS = {
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


def check_readable(path: str | os.PathLike[str], largest: float = LARGEST_TEXT) -> None:
    """Raise an OSError in words unless a path leads to a regular file of at most `largest` bytes.

    A device may have no end, and whoever opens a pipe waits for its other end.
    """
    found = os.stat(path)
    kind = stat.S_IFMT(found.st_mode)
    if kind != stat.S_IFREG:
        what = KINDS.get(kind, "something else")
        raise OSError(errno.EINVAL, f"it is no regular file but {what}")
    if found.st_size > largest:
        much = f"it holds {found.st_size / 1e6:.4g} MB, and at most {largest / 1e6:.4g} MB are read"
        raise OSError(errno.EFBIG, much)


def read_content(path: str | os.PathLike[str], largest: int = LARGEST_TEXT) -> bytes:
    """What a file holds; errors as of `check_readable`."""
    check_readable(path, largest)
    with open(path, "rb") as file:
        return file.read(largest)
