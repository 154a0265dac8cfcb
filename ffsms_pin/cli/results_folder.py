"""A results folder that is filled whole or not at all."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ffsms_pin.errors import FfsmsError, InvalidValue, ResultError

__all__ = ["chosen_folder", "results_folder"]


def chosen_folder(out: str | None, name: str) -> Path:
    """The folder that `--out` names; without it, results/<name>."""
    if out is not None and (not out.strip() or "\0" in out):
        raise InvalidValue("--out", out, "must name a folder")
    return Path(out) if out is not None else Path("results") / name


@contextmanager
def results_folder(out: Path) -> Iterator[Path]:
    """A temporary folder whose files move to `out` when the block ends well, and vanish when it does not.

    A folder that does not exist yet appears in one move. Into one that does, each file moves on its own,
    replacing its namesake; the temporary folder is then inside it, so that moving never crosses file systems.

    Parameters
    ----------
    out : Path
        Folders above it are made as needed, and removed again on failure.
    """
    made: list[Path] = []
    staging: Path | None = None
    try:
        if out.exists() and not out.is_dir():
            raise ResultError(out, "is a file; the results need a folder: choose another --out")
        _make_parents(out, made)
        staging = (out if out.exists() else out.parent) / f".{out.name}.{secrets.token_hex(4)}"
        staging.mkdir()
        yield staging
        _move(staging, out)
    except BaseException as error:
        if staging is not None:
            shutil.rmtree(staging, ignore_errors=True)
        for folder in reversed(made):
            with suppress(OSError):  # somebody else's files are in it by now
                folder.rmdir()
        if isinstance(error, OSError) and not isinstance(error, FfsmsError):
            raise ResultError(out, f"cannot be written ({error.strerror}); choose another --out") from None
        raise


def _make_parents(out: Path, made: list[Path]) -> None:
    """Make the folders above `out` that are missing, noting each."""
    missing: list[Path] = []
    while not (parent := (missing[-1] if missing else out).parent).exists():
        missing.append(parent)
    for folder in reversed(missing):
        folder.mkdir()
        made.append(folder)


def _move(staging: Path, out: Path) -> None:
    if not out.exists():
        staging.rename(out)
        return
    for file in sorted(staging.iterdir()):
        os.replace(file, out / file.name)
    staging.rmdir()
