"""Long recordings: rows that go to disk as they come, so that the memory taken does not grow with the run.

While a run lasts, its rows lie in a folder beside the result, `<name>.part` (see `unfinished`), one file an
array, mapped into memory: a run that is interrupted, or killed, leaves them there to be read. At the end they
become one npz file that is there whole or not at all, and the folder goes.
"""

from __future__ import annotations

import mmap
import os
import weakref
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import ResultError
from ffsms_pin.simulation.unfinished import ROWS, begun, check_stream, given_up
from ffsms_pin.storage import path_like, require_space, write_atomically

__all__ = ["RowStream", "save_mapped"]

BLOCK = 4096  # rows between two times that memory is given back


class RowStream:
    """Arrays on disk for the rows of a run that is going on; a context that ends with the run.

    Parameters
    ----------
    path : path
        The result, an npz file; its folder must exist. What an earlier run left unfinished there is kept
        beside it, as `<name>.part-1` or the next number that is free.

    Raises
    ------
    ResultError
        The files cannot be made, another run records to the same file, or a `<name>.part` that is not ours
        is in the way. The whole size of the rows is reserved, and that of the result must be free besides: a
        disk that is too small is found out before the run and not during it.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = check_stream(path_like("stream", path))
        self._arrays: dict[str, np.memmap[Any, Any]] = {}
        self._size = 0
        try:
            self.folder, handle, self.set_aside = begun(self.path)
            self._unlock = weakref.finalize(self, os.close, handle)
            self._rows = np.load(self.folder / f"{ROWS}.npy", mmap_mode="r+")
        except OSError as error:
            if isinstance(error, ResultError):
                raise
            raise ResultError(self.path, f"cannot be written ({error.strerror})") from None

    def __enter__(self) -> RowStream:
        return self

    def __exit__(self, *error: object) -> None:
        if self._unlock.alive and self._rows[0] == 0:  # it failed before there was anything to keep
            given_up(self.folder)
        self._unlock()  # from now on another run may take the place

    def empty(self, name: str, shape: tuple[int, ...]) -> FloatArray:
        """An array of zeros on disk; its first dimension counts rows."""
        self._arrays[name] = self._new(name, shape)
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

    def _new(self, name: str, shape: tuple[int, ...]) -> np.memmap[Any, Any]:
        file = self.folder / f"{name}.npy"
        try:
            array = np.lib.format.open_memmap(file, mode="w+", dtype=np.float64, shape=shape)
            if array.nbytes and hasattr(os, "posix_fallocate"):
                with open(file, "r+b") as opened:
                    os.posix_fallocate(opened.fileno(), 0, file.stat().st_size)
            self._size += array.nbytes
            require_space(self.path, self._size)  # for the result, beside the rows
        except OSError as error:
            given_up(self.folder)
            self._unlock()
            if isinstance(error, ResultError):
                raise
            raise ResultError(self.path, f"cannot be written ({error.strerror})") from None
        return array

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
