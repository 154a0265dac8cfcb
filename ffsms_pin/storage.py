"""Result files: written atomically, read with errors that say what is wrong."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np

from ffsms_pin.errors import InvalidValue, ResultError

__all__ = ["load_arrays", "path_like", "save_arrays", "write_atomically", "write_content"]

_FORMAT_KEY = "format"
_LONGEST_NAME = 255  # [bytes] of one part of a path, what file systems take


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


def write_atomically(path: str | os.PathLike[str], write: Callable[[IO[bytes]], None]) -> None:
    """Write a file so that it is there whole or not at all.

    Parameters
    ----------
    path : path
        Its folder must exist.
    write : callable
        Is given an open binary file, in the same folder, that takes the name at the end.
    """
    path = path_like("path", path)
    try:
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    except OSError as error:
        raise ResultError(path, f"cannot be written ({error.strerror})") from None
    try:
        with os.fdopen(handle, "wb") as file:
            write(file)
        os.chmod(temporary, 0o644)  # a temporary file is private, a result is not
        os.replace(temporary, path)
    except OSError as error:
        Path(temporary).unlink(missing_ok=True)
        raise ResultError(path, f"cannot be written ({error.strerror})") from None
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def write_content(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Write a text, in UTF-8, or bytes to a file that is there whole or not at all."""
    raw = content.encode() if isinstance(content, str) else content

    def write(file: IO[bytes]) -> None:
        file.write(raw)

    write_atomically(path, write)


def save_arrays(path: str | os.PathLike[str], kind: str, values: Mapping[str, Any]) -> None:
    """Write arrays, numbers and texts to a compressed npz file that says what `kind` of result it is."""
    arrays: dict[str, Any] = {_FORMAT_KEY: kind, **values}
    write_atomically(path, lambda file: np.savez_compressed(file, **arrays))


def load_arrays(
    path: str | os.PathLike[str], kind: str, names: Sequence[str], defaults: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Read what `save_arrays` wrote; every one of `names` must be there, or have a default."""
    path = path_like("path", path)
    try:
        # Opened here: numpy would leave a damaged archive open.
        with open(path, "rb") as stream:
            found = _arrays(path, stream)
    except ResultError:  # itself an OSError
        raise
    except FileNotFoundError:
        raise ResultError(path, "there is no such file") from None
    except OSError as error:
        raise ResultError(path, f"cannot be read ({error.strerror})") from None
    if str(found.get(_FORMAT_KEY)) != kind:
        raise ResultError(path, f"is not a {kind} file")
    found = {**(defaults or {}), **found}
    missing = [name for name in names if name not in found]
    if missing:
        raise ResultError(path, f"lacks {', '.join(missing)}; it was written by another version")
    return {name: found[name] for name in names}


def _arrays(path: str | os.PathLike[str], stream: IO[bytes]) -> dict[str, Any]:
    """All arrays of an npz file."""
    try:
        with np.load(stream, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except Exception:  # a damaged archive raises whatever the layer raises that stumbles over it
        raise ResultError(path, "is not an npz file of results") from None
