"""A results folder that is filled whole or not at all."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from ffsms_pin.errors import FfsmsError, InvalidValue, ResultError
from ffsms_pin.storage import regular_target, remove_leftovers, replace_file, require_space, write_content
from ffsms_pin.storage.files import COMPLETE, is_abandoned, open_folder, staged_folder

_SPACE = 16e6  # [bytes] for figures and numbers: less free space is found out before a run


def chosen_folder(out: str | None, name: str) -> Path:
    """The folder that `--out` names; without it, results/<name>."""
    if out is not None and (not out.strip() or "\0" in out):
        raise InvalidValue("--out", out, "must name a folder")
    return Path(out) if out is not None else Path("results") / name


def write_numbers(path: Path, numbers: Any) -> None:
    """Write numbers as JSON."""
    write_content(path, json.dumps(numbers, indent=2, ensure_ascii=False, allow_nan=False) + "\n")


@contextmanager
def results_folder(out: Path, at_once: bool = False) -> Iterator[Path]:
    """A temporary folder whose files move to `out` when the block ends well, and vanish when it does not.

    A folder that does not exist yet appears in one move. In one that does, the complete results arrive as
    one hidden folder, in one move, and from there each file replaces its namesake in one move: where a run is
    killed meanwhile, the next one into this folder moves the rest before it starts. Hidden folders that
    killed runs left are removed. Folders above are made as needed, and removed again on failure; a link is
    followed. `at_once` makes `out` at the start, for a run that writes there meanwhile: that stays.
    """
    named, out = out, Path(os.path.realpath(out))
    missing: list[Path] = []  # the folders that are made, the innermost first
    try:
        if out.exists() and not out.is_dir():
            raise ResultError(named, "is a file; the results need a folder: choose another --out")
        missing = [folder for folder in (out, *out.parents) if not folder.exists()]
        (out if at_once else out.parent).mkdir(parents=True, exist_ok=True)
        require_space(named, _SPACE)
        remove_leftovers(out.parent)
        if out.exists():
            remove_leftovers(out)
            _finish_moves(out)
        with staged_folder(out if out.exists() else out.parent, out.name) as staging:
            yield staging
            _move(staging, out)
    except BaseException as error:
        for folder in missing:
            with suppress(OSError):  # somebody else's files are in it by now
                folder.rmdir()
        if isinstance(error, OSError) and not isinstance(error, FfsmsError):
            raise ResultError(named, f"cannot be written ({error.strerror}); choose another --out") from None
        raise


def _move(staging: Path, out: Path) -> None:
    if not out.exists():
        staging.rename(out)
        return
    for file in _files(staging):
        regular_target(out / file)  # nothing moves unless everything can
    complete = out / (staging.name + COMPLETE)
    staging.rename(complete)
    _move_files(complete, out)


def _finish_moves(out: Path) -> None:
    """Move the results that a dead run had complete."""
    for complete in sorted(out.glob(f".*.ffsms-pin-*{COMPLETE}")):
        lock = open_folder(complete)
        try:
            if is_abandoned(lock):
                _move_files(complete, out)
        finally:
            os.close(lock)


def _move_files(complete: Path, out: Path) -> None:
    """Move every file of a complete folder; where one cannot be moved, the others stay for the next run."""
    try:
        for file in _files(complete):
            (out / file).parent.mkdir(parents=True, exist_ok=True)
            replace_file(complete / file, out / file)
        shutil.rmtree(complete)  # folders only, by now
    except OSError as error:
        why = error.problem if isinstance(error, ResultError) else error.strerror
        raise ResultError(
            out, f"not all results could be moved ({why}); the rest is in {complete}: the next run moves it"
        ) from None


def _files(folder: Path) -> list[Path]:
    """All files below a folder, as paths from there."""
    return sorted(path.relative_to(folder) for path in folder.rglob("*") if not path.is_dir())
