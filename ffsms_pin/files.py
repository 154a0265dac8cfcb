"""Functions that write files atomically, and functions that read files and describe faulty files."""

from __future__ import annotations

import errno
import json
import math
import os
import secrets
import shutil
import stat
import tomllib
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.errors import FfsmsError, InvalidValue, ResultError

LARGEST_TEXT = 2**26  # [bytes] size of a robot, scenario or summary file; hundreds of times the usual size
LARGEST_DATA = 2**31  # [bytes] size of a table or mesh file, such as a CSV table of an hour at 1 kHz

_LONGEST_NAME = 255  # [bytes] length of a file's or folder's name, the limit of file systems
_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}

_FORMAT_KEY = "format"
# An archive is rejected if it would unpack to more than a gigabyte and to more than twenty times its size.
# Arrays of doubles compress to half of their size, seldom to a tenth.
_UNPACKED = 2**30  # [bytes]
_RATIO = 20

# File name endings of other formats, and the functions that write them.
_TABLES = {".csv": "; ffsms_pin.export.to_csv(sms, motion, path) writes a table"}
_TABLES |= dict.fromkeys((".parquet", ".xlsx", ".feather"), "; ffsms_pin.export.to_dataframe makes a table")
_OTHER_FORMATS = {*_TABLES, ".txt", ".json", ".toml", ".yaml", ".yml", ".mat", ".h5", ".hdf5", ".npy", ".zip"}
_OTHER_FORMATS |= {".pkl", ".pickle", ".urdf", ".xml", ".html", ".pdf", ".png"}

_NUMBERS = "fiu"
_WRONG_KINDS = {_NUMBERS: "no numbers", "b": "no truth value", "U": "no text"}


def path_like(name: str, value: Any) -> Path:
    """Return an argument as a path; raise `InvalidValue` if no file system accepts it."""
    try:
        path = os.fspath(value)
        if not isinstance(path, str) or not path or "\0" in path:
            raise TypeError
        if any(len(part) > _LONGEST_NAME for part in os.fsencode(path).split(b"/")):
            raise TypeError
    except (TypeError, UnicodeEncodeError):
        expected = "must be a path: not empty, without null characters, and with names of at most 255 bytes"
        raise InvalidValue(name, value, expected) from None
    return Path(path)


@contextmanager
def wrap_os_error(path: str | os.PathLike[str], action: str = "written") -> Iterator[None]:
    """Convert an OSError in the block into a `ResultError` with `path` and the failed `action`."""
    try:
        yield
    except FfsmsError:  # a `ResultError` is an OSError, too
        raise
    except OSError as error:
        missing = action == "read" and isinstance(error, FileNotFoundError)
        folderless = isinstance(error, FileNotFoundError) and not os.path.isdir(Path(path).parent)
        reason = "its folder does not exist" if folderless else error.strerror or error
        problem = "there is no such file" if missing else f"cannot be {action} ({reason})"
        raise ResultError(path, problem) from None


# Reading


def check_readable(path: str | os.PathLike[str], largest: float = LARGEST_TEXT) -> None:
    """Raise an OSError with a clear text unless `path` is a regular file of at most `largest` bytes.

    A device may have no end, and opening a pipe blocks until another process opens its other end.
    """
    status = os.stat(path)
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, f"it is not a regular file but {_kind(status)}")
    if status.st_size > largest:
        sizes = f"it holds {status.st_size / 1e6:.4g} MB, and at most {largest / 1e6:.4g} MB are read"
        raise OSError(errno.EFBIG, sizes)


def read_content(path: str | os.PathLike[str], largest: int = LARGEST_TEXT) -> bytes:
    """Return the bytes of a file; raise the errors of `check_readable`."""
    check_readable(path, largest)
    with open(path, "rb") as file:
        # read(largest) would allocate `largest` bytes for a small file, too.
        return file.read(min(largest, os.fstat(file.fileno()).st_size))


def read_json(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the object in a JSON file; raise `ResultError` if the file is unreadable or has no object."""
    try:
        with wrap_os_error(path, "read"):
            content = json.loads(read_content(path))
    except (ValueError, RecursionError) as error:
        raise ResultError(path, f"is not a JSON file ({error})") from None
    if not isinstance(content, dict):
        raise ResultError(path, "does not hold a JSON object")
    return content


def read_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the table in a TOML file; raise `ResultError` if the file is unreadable or not TOML."""
    try:
        with wrap_os_error(path, "read"):
            return tomllib.loads(read_content(path).decode("utf-8-sig"))
    except UnicodeDecodeError:
        raise ResultError(path, "is not a TOML file (not UTF-8 text)") from None
    except (ValueError, RecursionError) as error:  # also a path with a null character
        raise ResultError(path, f"is not a TOML file ({error})") from None


def load_arrays(path: str | os.PathLike[str], kind: str, names: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Return the named arrays of an npz file that `save_arrays` wrote for the same `kind` of result.

    Pickled objects and arrays with other names are never read. `ResultError` is raised if the file is
    missing, damaged, incomplete, of another kind, or too large when unpacked.
    """
    path = path_like("path", path)
    try:
        with wrap_os_error(path, "read"):
            check_readable(path, math.inf)  # `_named_arrays` limits the size
            # numpy.load does not close the file of a path if the archive is damaged; this block does.
            with open(path, "rb") as file:
                with zipfile.ZipFile(file) as archive:
                    sizes = {
                        info.filename.removesuffix(".npy"): info.file_size for info in archive.infolist()
                    }
                file.seek(0)
                with np.load(file, allow_pickle=False) as arrays:
                    return _named_arrays(path, arrays, sizes, kind, names)
    except ResultError:
        raise
    except MemoryError:
        raise ResultError(path, "is too large for this machine's memory") from None
    except Exception:  # zipfile, zlib and NumPy raise any type for a damaged archive
        table = path.suffix.lower() == ".csv"
        remedy = "; ffsms_pin.export.read_csv(sms, path) reads a table" if table else ", or is damaged"
        raise ResultError(path, f"is not an npz file of results{remedy}") from None


def _named_arrays(
    path: Path, arrays: Mapping[str, NDArray[Any]], sizes: Mapping[str, int], kind: str, names: Sequence[str]
) -> dict[str, NDArray[Any]]:
    """Check an archive's kind, names and unpacked `sizes` [bytes], and return the named arrays."""
    unpacked = sum(sizes.get(name, 0) for name in (*names, _FORMAT_KEY))
    packed = path.stat().st_size
    if unpacked > max(_UNPACKED, _RATIO * packed):
        raise ResultError(
            path,
            f"would unpack to {unpacked / 1e9:.3g} GB from {packed / 1e6:.3g} MB, more than any recording; "
            "it is not read",
        )
    if _FORMAT_KEY not in sizes or str(arrays[_FORMAT_KEY]) != kind:
        raise ResultError(path, f"is not a {kind} file")
    if missing := [name for name in names if name not in sizes]:
        remedy = "it is from another version of ffsms-pin, so make it again with this version"
        raise ResultError(path, f"lacks {', '.join(missing)}; {remedy}")
    return {name: arrays[name] for name in names}


def check_shapes(
    path: str | os.PathLike[str],
    arrays: Mapping[str, NDArray[Any]],
    shapes: Mapping[str, tuple[str | int, ...]],
    kinds: Mapping[str, str] | None = None,
) -> None:
    """Raise `ResultError` unless arrays have the expected kinds of data and consistent shapes.

    A dimension in `shapes` is a number, the name of a size ("N", "n", "nq"), or a name plus a number
    ("N+1"). The first array with a named size sets its value. If both "n" (joints) and "nq" are named, nq
    must be 7 + n to 7 + 2 n, because a free base has 7 entries of q, a continuous joint 2 and any other
    joint 1. `kinds` maps the names of arrays that are not numeric to NumPy's letter for their kind of data.
    """
    sizes: dict[str, int] = {}
    for name, dimensions in shapes.items():
        array, kind = arrays[name], (kinds or {}).get(name, _NUMBERS)
        if array.dtype.kind not in kind:
            raise ResultError(path, f"holds {_WRONG_KINDS[kind]} in {name}")
        expected: list[int | None] = []  # None while no array has set the size
        for k, dimension in enumerate(dimensions):
            if isinstance(dimension, int):
                expected.append(dimension)
                continue
            size_name, _, added = dimension.partition("+")
            if len(array.shape) == len(dimensions):
                sizes.setdefault(size_name, array.shape[k] - int(added or 0))
            size = sizes.get(size_name)
            # A negative size is not changed, so no array can have the expected shape.
            expected.append(size if size is None or size < 0 else size + int(added or 0))
        if array.shape != tuple(expected):
            fit = ", ".join("any" if size is None else "more" if size < 0 else str(size) for size in expected)
            comma = "," if len(expected) == 1 else ""
            raise ResultError(path, f"holds {name} of shape {array.shape} where ({fit}{comma}) would fit")
    n, nq = sizes.get("n"), sizes.get("nq")
    if n is not None and nq is not None and not 7 + n <= nq <= 7 + 2 * n:
        raise ResultError(
            path, f"holds q of shape {arrays['q'].shape} where {7 + n} to {7 + 2 * n} columns would fit"
        )


def check_times(path: str | os.PathLike[str], t: NDArray[np.float64], least: int = 1) -> None:
    """Raise `ResultError` unless t has at least `least` instants that are finite and increasing."""
    if len(t) < least:
        raise ResultError(path, f"holds {len(t)} instants in t where at least {least} are needed")
    if not (np.isfinite(t).all() and (np.diff(t) > 0.0).all()):
        raise ResultError(path, "holds instants in t that are not finite or do not increase")


def numbers_by_name(path: str | os.PathLike[str], name: str, text: str, rows: bool = False) -> dict[str, Any]:
    """Parse a JSON object of numbers; if `rows` is True, parse an object of lists into arrays (k,)."""
    try:
        table = json.loads(text)
        if rows:
            return {key: np.array([_number(value) for value in row]) for key, row in table.items()}
        return {key: _number(value) for key, value in table.items()}
    except (ValueError, TypeError, AttributeError, OverflowError, RecursionError):
        raise ResultError(path, f"holds no JSON object of numbers in {name}") from None


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError("no number")
    return float(value)


# Writing


def write_atomically(path: str | os.PathLike[str], write: Callable[[IO[bytes]], object]) -> None:
    """Write a file completely or not at all, also if the power fails.

    `write` writes to a hidden binary file in the same folder, which is renamed to `path` at the end. If
    `path` is a link, its target is replaced. A replaced file keeps its mode. If the file cannot be written,
    `ResultError` is raised and the old file is unchanged.
    """
    target = regular_target(path)
    with wrap_os_error(path):
        temporary = hidden_path(target.parent, target.name)
        try:
            with open(temporary, "xb") as file:
                with suppress(FileNotFoundError):
                    shutil.copymode(target, temporary)
                write(file)
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(target)
        finally:
            temporary.unlink(missing_ok=True)


def write_content(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Write bytes, or a text in UTF-8, to a file atomically."""
    data = content.encode() if isinstance(content, str) else content
    write_atomically(path, lambda file: file.write(data))


def save_arrays(path: str | os.PathLike[str], kind: str, values: Mapping[str, Any]) -> None:
    """Write arrays, numbers and texts, and the `kind` of result, to a compressed npz file atomically.

    `InvalidValue` is raised if the file name has the ending of another format.
    """
    if (suffix := path_like("path", path).suffix.lower()) in _OTHER_FORMATS:
        message = "must end in .npz, because the format is NumPy's archive, read by load"
        raise InvalidValue("path", os.fspath(path), message + _TABLES.get(suffix, ""))
    arrays: dict[str, Any] = {_FORMAT_KEY: kind, **values}
    write_atomically(path, lambda file: np.savez_compressed(file, **arrays))


def regular_target(path: str | os.PathLike[str]) -> Path:
    """Resolve the links of a path; raise `ResultError` if the result exists and is not a regular file."""
    target = Path(os.path.realpath(path_like("path", path)))
    with wrap_os_error(path):
        if target.exists() and not target.is_file():
            kind = _kind(target.stat())
            raise ResultError(
                path, f"is {kind}; results are written to regular files only, so choose another name"
            )
    return target


def check_writable(path: str | os.PathLike[str]) -> Path:
    """Check that a file can be written, before a long run, and return its path with all links resolved."""
    target = regular_target(path)
    with wrap_os_error(path):
        temporary = hidden_path(target.parent, target.name)
        temporary.touch(exist_ok=False)
        temporary.unlink()
    return target


def hidden_path(folder: Path, name: str) -> Path:
    """Return a new hidden path in `folder` for a file or folder that is renamed to `name` when complete."""
    # The name is cut, because file systems allow 255 bytes.
    return folder / f".{name[:40]}.ffsms-pin-{secrets.token_hex(4)}"


def _kind(status: os.stat_result) -> str:
    """Return the kind of a file as text."""
    return _KINDS.get(stat.S_IFMT(status.st_mode), "something else")
