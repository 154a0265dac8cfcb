"""The folder `<name>.part` of a recording that is not complete: made, found again, set aside.

A mark in it says that it is ours, and a lock that its run is alive. A file or folder of that name without the
mark belongs to somebody else, and is never read or touched.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ffsms_pin.errors import ResultError
from ffsms_pin.storage import check_readable, check_writable, read_content, regular_target
from ffsms_pin.storage.temporary import hidden_path, is_abandoned, locked_folder, open_folder

__all__ = ["ROWS", "begun", "check_stream", "given_up", "part_folder", "recorded"]

ROWS = "rows"  # the array that says how many rows are done
HELD = ("tau", "wheel_torque", "thruster_force")  # arrays with one row a step
_MARK, _WORDS = "ffsms-pin-recording", "ffsms-pin: rows of a recording that is not complete\n"


def part_folder(path: str | os.PathLike[str]) -> Path:
    """Where the rows of the result `path` are until it is complete; a link is followed."""
    path = Path(os.path.realpath(path))
    return path.parent / f"{path.name}.part"  # "/" has no name to be changed


def check_stream(path: str | os.PathLike[str]) -> Path:
    """The file that a recording can be streamed to.

    Raises
    ------
    ResultError
        It cannot be written, or what is in the way must not be moved.
    """
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
    """A new, marked and locked folder for the rows of a result.

    Returns
    -------
    folder : Path
    handle : int
        The descriptor that holds the lock, to be closed at the end of the run.
    set_aside : Path or None
        Where the rows of an earlier run are now that was left unfinished.
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
    path: str | os.PathLike[str], names: Sequence[str], optional: Sequence[str] = ()
) -> dict[str, Any] | None:
    """Arrays of the rows that an unfinished run left, mapped read-only; None where there are none.

    Parameters
    ----------
    path : path
        That of the result, or that of the folder.
    names : sequence of str
        The arrays to read.
    optional : sequence of str
        Those to read where they are there.

    Raises
    ------
    ResultError
        The rows cannot be read, or there is a complete file beside them: it may be the result of an older
        run, and nobody should take the one for the other.
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
    there = [name for name in (*names, *optional) if (folder / f"{name}.npy").is_file()]
    if missing := [name for name in names if name not in there]:
        raise ResultError(path, f"was left unfinished and lacks {', '.join(missing)}")
    try:
        arrays = {name: np.load(folder / f"{name}.npy", mmap_mode="r") for name in there}
        # What is held over a step belongs to its end as well: the last row has none yet.
        return {name: array[: rows - (name in HELD)] for name, array in arrays.items()}
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
