"""Arrays in npz files: written atomically, read only after their sizes were looked at, and made to fit."""

from __future__ import annotations

import json
import math
import os
import zipfile
from collections.abc import Callable, Mapping, Sequence
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.errors import ResultError
from ffsms_pin.storage.files import check_readable, path_like, told, write_atomically

_FORMAT_KEY = "format"
# Packed arrays of doubles shrink to a half, seldom to a tenth. What would unpack to more than a gigabyte and
# to more than twenty times the file's own size is refused.
_UNPACKED = 2**30  # [bytes]
_RATIO = 20

NUMBERS, TRUTH, TEXT = "fiu", "b", "U"
_KINDS = {NUMBERS: "no numbers", TRUTH: "no yes or no", TEXT: "no text"}


class Header(NamedTuple):
    """What the head of an array says about it."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    @property
    def nbytes(self) -> int:
        """Size of the array [bytes]."""
        return math.prod(self.shape) * self.dtype.itemsize  # Python's integers do not overflow


def save_arrays(
    path: str | os.PathLike[str], kind: str, values: Mapping[str, Any], durable: bool = False
) -> None:
    """Write arrays, numbers and texts to a compressed npz file that says what `kind` of result it is."""
    arrays: dict[str, Any] = {_FORMAT_KEY: kind, **values}
    write_atomically(path, lambda file: np.savez_compressed(file, **arrays), durable)


def load_arrays(
    path: str | os.PathLike[str],
    kind: str,
    names: Sequence[str],
    defaults: Mapping[str, Any] | None = None,
    check: Callable[[Mapping[str, Any]], None] | None = None,
) -> dict[str, Any]:
    """Read what `save_arrays` wrote; each of `names` must be there, or have a default, as older files need.

    Nothing else is read from the file, and nothing before its size is known. `check` is given the headers of
    the arrays, by name, before any of them is read; it raises `ResultError` where they do not fit.
    """
    path = path_like("path", path)
    try:
        with told(path, "read"):
            check_readable(path, math.inf)  # of its arrays only those that are named are read
            # Opened here: an archive that is damaged would be left open.
            with open(path, "rb") as stream:
                return _read(path, stream, kind, names, defaults or {}, check)
    except ResultError:
        raise
    except MemoryError:
        raise ResultError(path, "is too large for this machine's memory") from None
    except Exception:  # a damaged archive raises whatever the layer raises that stumbles over it
        raise ResultError(path, "is not an npz file of results") from None


def _read(
    path: str | os.PathLike[str],
    stream: IO[bytes],
    kind: str,
    names: Sequence[str],
    defaults: Mapping[str, Any],
    check: Callable[[Mapping[str, Any]], None] | None,
) -> dict[str, Any]:
    with zipfile.ZipFile(stream) as archive:
        there = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
        if _FORMAT_KEY not in there or not _is_text(archive, there[_FORMAT_KEY], kind):
            raise ResultError(path, f"is not a {kind} file")
        missing = [name for name in names if name not in there and name not in defaults]
        if missing:
            raise ResultError(path, f"lacks {', '.join(missing)}; it was written by another version")
        headers = {name: _header(archive, there[name]) for name in names if name in there}
        unpacked = sum(header.nbytes for header in headers.values())
        packed = os.fstat(stream.fileno()).st_size
        if unpacked > max(_UNPACKED, _RATIO * packed):
            raise ResultError(
                path,
                f"would unpack to {unpacked / 1e9:.3g} GB from {packed / 1e6:.3g} MB, as no recording does; "
                "it is not read",
            )
        if check is not None:
            check({**defaults, **headers})
        return {
            name: _array(archive, there[name]) if name in there else np.array(defaults[name])
            for name in names
        }


def _is_text(archive: zipfile.ZipFile, info: zipfile.ZipInfo, text: str) -> bool:
    """Whether a member holds a text; one of another length is not read."""
    header = _header(archive, info)
    same = header.shape == () and header.dtype.kind == "U" and header.nbytes == np.array(text).nbytes
    return same and str(_array(archive, info)) == text


def _header(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> Header:
    """Shape and type of a member, without reading it; a ValueError where it holds less than they say."""
    with archive.open(info) as member:
        version = np.lib.format.read_magic(member)
        read = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }[version]
        shape, _, dtype = read(member)
        header = Header(shape, dtype)
        if dtype.hasobject or header.nbytes != info.file_size - member.tell():
            raise ValueError("not the size that its header says")
    return header


def _array(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> Any:
    with archive.open(info) as member:  # never gives more bytes than `info` says
        return np.lib.format.read_array(member, allow_pickle=False)


def check_shapes(
    path: str | os.PathLike[str],
    arrays: Mapping[str, Any],
    wanted: Mapping[str, tuple[str | int, ...]],
    others: Mapping[str, str] | None = None,
) -> None:
    """Raise `ResultError` unless arrays hold what they should, in shapes that fit together.

    `arrays` are anything with `shape` and `dtype`, as headers. `wanted` has the dimensions of each: numbers,
    or sizes by name ("N", "n", "nq") with or without a number added ("N+1"); the first array that has a size
    sets it. Where "n" joints and "nq" are named, nq is checked against n: a free base has 7 of them, and a
    joint 1 or, where it turns for ever, 2. `others` has the kinds of data (numpy's letters) of arrays that
    hold no numbers.
    """
    sizes: dict[str, int] = {}
    for name, dimensions in wanted.items():
        array, kind = arrays[name], (others or {}).get(name, NUMBERS)
        if array.dtype.kind not in kind:
            raise ResultError(path, f"holds {_KINDS[kind]} in {name}")
        expected: list[int | None] = []  # None where no array has set it yet
        for k, dimension in enumerate(dimensions):
            if isinstance(dimension, int):
                expected.append(dimension)
                continue
            word, _, added = dimension.partition("+")
            if len(array.shape) == len(dimensions):
                sizes.setdefault(word, array.shape[k] - int(added or 0))
            size = sizes.get(word)
            # A negative size fits no array.
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
    """Raise `ResultError` unless there are so many instants, finite and rising."""
    if len(t) < least:
        raise ResultError(path, f"holds {len(t)} instants in t where at least {least} are needed")
    if not (np.isfinite(t).all() and (np.diff(t) > 0.0).all()):
        raise ResultError(path, "holds instants in t that do not rise")


def numbers_by_name(path: str | os.PathLike[str], name: str, text: str, rows: bool = False) -> dict[str, Any]:
    """Numbers, or rows of numbers as arrays, that a result keeps by name in a text of JSON."""
    try:
        found = json.loads(text)
        if rows:
            return {key: np.array([_number(one) for one in row]) for key, row in found.items()}
        return {key: _number(value) for key, value in found.items()}
    except (ValueError, TypeError, AttributeError, OverflowError, RecursionError):
        raise ResultError(path, f"holds no numbers by name in {name}") from None


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError("no number")
    return float(value)
