"""Long recordings: rows that go to disk as they come, so that the memory taken does not grow with the run.

While a run lasts, its rows lie in a folder beside the result, `<name>.part`, one file an array, mapped into
memory: a run that is interrupted, or killed, leaves them there to be read. At the end they become one npz
file that is there whole or not at all, and the folder goes.
"""

from __future__ import annotations

import mmap
import os
import shutil
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import ResultError
from ffsms_pin.storage import path_like, write_atomically

__all__ = ["RowStream", "part_folder", "recorded", "save_mapped"]

BLOCK = 4096  # rows between two times that memory is given back
_ROWS = "rows"  # the file that says how many rows are done


def part_folder(path: str | os.PathLike[str]) -> Path:
    """Where the rows of the result `path` are until it is complete."""
    path = Path(path)
    return path.with_name(path.name + ".part")


class RowStream:
    """Arrays on disk for the rows of a run that is going on.

    Parameters
    ----------
    path : path
        The result, an npz file; its folder must exist. What an earlier run left unfinished there is removed.

    Raises
    ------
    ResultError
        The files cannot be made. Their whole size is reserved then, so a disk that is too small is found out
        before the run and not during it.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = path_like("stream", path)
        self.folder = part_folder(path)
        shutil.rmtree(self.folder, ignore_errors=True)
        self._arrays: dict[str, np.memmap[Any, Any]] = {}
        try:
            self.folder.mkdir()
        except OSError as error:
            raise ResultError(self.path, f"cannot be written ({error.strerror})") from None
        self._rows = self._new(_ROWS, (1,), np.int64)

    def empty(self, name: str, shape: tuple[int, ...]) -> FloatArray:
        """An array of zeros on disk; its first dimension counts rows."""
        self._arrays[name] = self._new(name, shape, np.float64)
        return self._arrays[name]

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

    def _new(self, name: str, shape: tuple[int, ...], kind: type) -> np.memmap[Any, Any]:
        file = self.folder / f"{name}.npy"
        try:
            array = np.lib.format.open_memmap(file, mode="w+", dtype=kind, shape=shape)
            if array.nbytes and hasattr(os, "posix_fallocate"):
                with open(file, "r+b") as opened:
                    os.posix_fallocate(opened.fileno(), 0, file.stat().st_size)
        except OSError as error:
            shutil.rmtree(self.folder, ignore_errors=True)
            raise ResultError(self.path, f"cannot be written ({error.strerror})") from None
        return array

    def finish(self, save: Callable[[Path], None]) -> None:
        """Let `save` write the result, and remove the folder: mapped arrays stay readable without it."""
        for array in self._arrays.values():
            _give_back(array)
        save(self.path)
        shutil.rmtree(self.folder, ignore_errors=True)


def recorded(path: str | os.PathLike[str]) -> dict[str, Any] | None:
    """Arrays of the rows that an unfinished run left, mapped read-only; None where there are none.

    `path` is the result's, which is not there, or that of the folder.
    """
    folder = Path(path)
    if not folder.is_dir():
        folder = part_folder(path)
        if os.path.exists(path) or not folder.is_dir():
            return None
    try:
        arrays = {file.stem: np.load(file, mmap_mode="r") for file in sorted(folder.glob("*.npy"))}
        rows = int(arrays.pop(_ROWS)[0])
        # The torque of a step belongs to its end as well: the last row has none yet.
        if rows > 0:
            return {name: array[: rows - (name == "tau")] for name, array in arrays.items()}
    except (OSError, EOFError, ValueError, KeyError, IndexError):
        raise ResultError(path, "was left unfinished, and its rows cannot be read") from None
    raise ResultError(path, "was left unfinished before its first row")


def save_mapped(path: str | os.PathLike[str], kind: str, values: Mapping[str, Any]) -> None:
    """What `storage.save_arrays` does, without compression and block by block."""

    def write(file: IO[bytes]) -> None:
        with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
            for name, value in {"format": kind, **values}.items():
                array = np.asanyarray(value)
                with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                    header = np.lib.format.header_data_from_array_1_0(np.empty((0,), array.dtype))
                    header["shape"] = array.shape
                    np.lib.format.write_array_header_1_0(member, header)
                    if array.ndim == 0:
                        member.write(array.tobytes())
                        continue
                    for first in range(0, len(array), BLOCK):
                        member.write(np.ascontiguousarray(array[first : first + BLOCK]).tobytes())
                        _give_back(array)

    write_atomically(path, write)


def _give_back(array: Any) -> None:
    """Let the system take back the memory of a mapped array; its pages come again from the file."""
    base = array
    while base is not None and not isinstance(base, mmap.mmap):
        base = getattr(base, "base", None) if not isinstance(base, memoryview) else base.obj
    if base is not None and hasattr(mmap, "MADV_DONTNEED"):
        base.madvise(mmap.MADV_DONTNEED)
