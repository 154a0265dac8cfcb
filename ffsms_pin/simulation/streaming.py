"""Long recordings: rows that go to disk as they come.

While a run lasts, its rows lie in a folder beside the result, `<name>.part`, one file an array, mapped into
memory: a run that is interrupted, or killed, leaves them there to be read. At the end they become one npz
file that is there whole or not at all, and the folder goes.
"""

from __future__ import annotations

import mmap
import os
import shutil
import weakref
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import IO, Any, TypeAlias

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import ResultError
from ffsms_pin.files import (
    check_readable,
    check_writable,
    hidden_path,
    is_abandoned,
    locked_folder,
    open_folder,
    path_like,
    read_content,
    regular_target,
    require_space,
    wrap_os_error,
    write_atomically,
)

Shape: TypeAlias = tuple[str | int, ...]

BLOCK = 4096  # rows between two times that memory is given back

ROWS = "rows"  # the array that says how many rows are done
_MARK, _WORDS = "ffsms-pin-recording", "ffsms-pin: rows of a recording that is not complete\n"


class RowStream:
    """Arrays on disk for the rows of a run that is going on; a context that ends with the run.

    `path` is the result, an npz file in a folder that exists. What an earlier run left unfinished there is
    kept as `<name>.part-1` or the next number that is free; a `<name>.part` of another run, or that is not
    ours, is refused. The whole size of the rows is reserved, and that of the result must be free besides: a
    disk that is too small is found out before the run and not during it.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = check_stream(path_like("stream", path))
        self._arrays: dict[str, np.memmap[Any, Any]] = {}
        self._size = 0
        with wrap_os_error(self.path):
            self.folder, handle, self.set_aside = begun(self.path)
            self._unlock = weakref.finalize(self, os.close, handle)
            self._rows = np.load(self.folder / f"{ROWS}.npy", mmap_mode="r+")

    def __enter__(self) -> RowStream:
        return self

    def __exit__(self, *error: object) -> None:
        if self._unlock.alive and self._rows[0] == 0:  # it failed before there was anything to keep
            given_up(self.folder)
        self._unlock()  # from now on another run may take the place

    def empty(self, name: str, shape: tuple[int, ...]) -> FloatArray:
        """An array of zeros on disk; its first dimension counts rows."""
        file = self.folder / f"{name}.npy"
        with wrap_os_error(self.path):
            array = np.lib.format.open_memmap(file, mode="w+", dtype=np.float64, shape=shape)
            if array.nbytes and hasattr(os, "posix_fallocate"):
                with open(file, "r+b") as opened:
                    os.posix_fallocate(opened.fileno(), 0, file.stat().st_size)
            self._size += array.nbytes
            require_space(self.path, self._size)  # for the result, beside the rows
        self._arrays[name] = array
        return array

    def times(self, duration: float, steps: int) -> FloatArray:
        """`numpy.linspace(0, duration, steps + 1)` on disk, as array "t"."""
        t = self.empty("t", (steps + 1,))
        for first in range(0, steps + 1, BLOCK):
            rows = np.arange(first, min(first + BLOCK, steps + 1))
            t[rows] = rows * (duration / steps)
        t[steps] = duration
        return t

    def added(self, k: int) -> None:
        """Row k is complete."""
        self._rows[0] = k + 1
        if (k + 1) % BLOCK == 0:
            for array in self._arrays.values():
                _give_back(array)

    def finish(self, save: Callable[[Path], None]) -> None:
        """Let `save` write the result, and remove the folder: mapped arrays stay readable without it."""
        for array in self._arrays.values():
            _give_back(array)
        try:
            save(self.path)
        except ResultError as error:
            raise ResultError(error.path, f"{error.problem}; the recording is in {self.folder}") from None
        given_up(self.folder)
        self._unlock()


def save_mapped(path: str | os.PathLike[str], kind: str, values: Mapping[str, Any]) -> None:
    """What `files.save_arrays` does, without compression and block by block."""

    def write(file: IO[bytes]) -> None:
        with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
            for name, value in {"format": kind, **values}.items():
                array = np.asanyarray(value)
                rows = np.atleast_1d(array)
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    header = np.lib.format.header_data_from_array_1_0(array)
                    np.lib.format.write_array_header_1_0(member, header)
                    for first in range(0, len(rows), BLOCK):
                        member.write(rows[first : first + BLOCK].tobytes())
                        _give_back(array)

    write_atomically(path, write)


def _give_back(array: Any) -> None:
    """Let the system take back the memory of a mapped array; its pages come again from the file."""
    base = array
    while base is not None and not isinstance(base, mmap.mmap):
        base = getattr(base, "base", None) if not isinstance(base, memoryview) else base.obj
    if base is not None and hasattr(mmap, "MADV_DONTNEED"):
        base.madvise(mmap.MADV_DONTNEED)


def part_folder(path: str | os.PathLike[str]) -> Path:
    """Where the rows of the result `path` are until it is complete; a link is followed."""
    path = Path(os.path.realpath(path))
    return path.parent / f"{path.name}.part"  # "/" has no name to be changed


def check_stream(path: str | os.PathLike[str]) -> Path:
    """The file that a recording can be streamed to; `ResultError` where what is in the way must stay."""
    target = check_writable(path)
    folder = part_folder(target)
    if os.path.lexists(folder):
        if not _is_ours(folder):
            raise ResultError(
                path, f"cannot be streamed to: {folder} is in the way, and no recording of ours; move it away"
            )
        if _is_alive(folder):
            raise ResultError(
                path, f"is being recorded by another run; choose another name, or move {folder} away"
            )
    return target


def begun(target: Path) -> tuple[Path, int, Path | None]:
    """A new, marked folder for the rows of a result, and the descriptor whose closing unlocks it.

    The third is where the rows of an earlier run are now that was left unfinished, if there was one.
    """
    folder, set_aside = part_folder(target), None
    made, handle = locked_folder(folder.parent, folder.name)
    try:
        (made / _MARK).write_text(_WORDS, encoding="utf-8")
        np.save(made / f"{ROWS}.npy", np.zeros(1, dtype=np.int64))
        if os.path.lexists(folder):
            set_aside = _cleared(folder)
        made.rename(folder)  # in one step it is there with its mark
    except BaseException:
        shutil.rmtree(made, ignore_errors=True)
        os.close(handle)
        raise
    return folder, handle, set_aside


def given_up(folder: Path) -> None:
    """Remove a folder of ours: in one step it is no recording any more."""
    hidden = hidden_path(folder.parent, folder.name)
    folder.rename(hidden)
    shutil.rmtree(hidden, ignore_errors=True)


def recorded(
    path: str | os.PathLike[str], wanted: Mapping[str, Shape], optional: Mapping[str, Shape]
) -> dict[str, Any] | None:
    """Arrays of the rows that an unfinished run left, mapped read-only; None where there are none.

    `path` is that of the result or of the folder. Arrays go by name, with their shapes as for
    `check_shapes`; those that are `optional` are read where they are there. A complete file beside the rows
    is refused: it may be the result of an older run, and nobody should take the one for the other.
    """
    folder = Path(path)
    if not _is_ours(folder):
        folder = part_folder(path)
        if not _is_ours(folder):
            return None
        if os.path.lexists(regular_target(path)):
            if _rows(folder) == 0:
                return None
            raise ResultError(
                path,
                f"is complete, but {folder} holds rows of another run that is not: load '{folder}' for these,"
                " or with complete=True the complete file",
            )
    rows = _rows(folder)
    if rows == 0:
        raise ResultError(path, "was left unfinished before its first row")
    there = {
        name: shape for name, shape in {**wanted, **optional}.items() if (folder / f"{name}.npy").is_file()
    }
    if missing := [name for name in wanted if name not in there]:
        raise ResultError(path, f"was left unfinished and lacks {', '.join(missing)}")
    try:
        arrays = {name: np.load(folder / f"{name}.npy", mmap_mode="r") for name in there}
        # What is held over a step belongs to its end as well: the last row has none yet.
        return {name: array[: rows - (there[name][0] == "N")] for name, array in arrays.items()}
    except (OSError, EOFError, ValueError, IndexError):  # its run was killed while it made them
        raise ResultError(path, "was left unfinished, and its rows cannot be read") from None


def _is_ours(folder: Path) -> bool:
    """Whether a recording of ours is in a folder; a link to one is none."""
    mark = folder / _MARK
    try:
        return not folder.is_symlink() and read_content(mark) == _WORDS.encode()
    except (OSError, ValueError):
        return False


def _is_alive(folder: Path) -> bool:
    handle = open_folder(folder)
    try:
        return not is_abandoned(handle)
    finally:
        os.close(handle)


def _rows(folder: Path) -> int:
    """How many rows are complete."""
    try:
        check_readable(folder / f"{ROWS}.npy")
        return int(np.load(folder / f"{ROWS}.npy")[0])
    except (OSError, ValueError, EOFError, IndexError):
        raise ResultError(folder, "was left unfinished, and its rows cannot be read") from None


def _cleared(folder: Path) -> Path | None:
    """Make way for a new recording: rows of an earlier run are kept under the next free name."""
    if not _is_ours(folder) or _is_alive(folder):  # it came since `check_stream` looked
        raise ResultError(folder, "is in the way: another run has just made it")
    try:
        recorded_rows = _rows(folder)
    except ResultError:  # perhaps somebody can still read them
        recorded_rows = 1
    if recorded_rows == 0:
        given_up(folder)
        return None
    number = 1
    while os.path.lexists(kept := folder.with_name(f"{folder.name}-{number}")):
        number += 1
    folder.rename(kept)
    return kept
