"""Classify the outcome of a trial: a result, an error of the library, or a fault."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from ffsms_pin.errors import FfsmsError, TasksFailed

__all__ = ["GOOD", "Trial", "Verdict", "judged"]

GOOD = ("result", "our error")
_ROOT = Path(__file__).resolve().parents[2]


class Trial(NamedTuple):
    """A description of a trial, and the function that runs it."""

    what: str
    work: Callable[[], Any]


class Verdict(NamedTuple):
    """The outcome of a trial.

    Attributes
    ----------
    kind : str
        The kind of trial: "urdfs", "scenarios", "calls" or "kills".
    seed : int
    what : str
        A description of the trial.
    outcome : str
        One of `GOOD`, or "other error", "warning", "memory", "hang", "crash".
    detail : str
        The error, and the innermost lines of the project's code.
    """

    kind: str
    seed: int
    what: str
    outcome: str
    detail: str


def judged(work: Callable[[], Any]) -> tuple[str, str]:
    """Return outcome and detail of a trial that neither hangs nor crashes."""
    try:
        work()
    except FfsmsError as error:
        return _library_error(error)
    except Warning as warning:
        return "warning", _description(warning)
    except MemoryError as error:
        return "memory", _description(error)
    except BaseException as error:
        return "other error", _description(error)
    return "result", ""


def _library_error(error: FfsmsError) -> tuple[str, str]:
    line = str(error)
    if not line.strip() or "\n" in line:
        return "other error", f"the text of {type(error).__name__} is not one line: {line!r}"
    if isinstance(error, TasksFailed):
        for failure in error.failures.values():
            if not isinstance(failure, FfsmsError):
                return "other error", f"in another process: {type(failure).__name__}: {failure}"
    return "our error", f"{type(error).__name__}: {line}"


def _description(error: BaseException) -> str:
    """Return class and text of an error, and the innermost lines of the project's code."""
    own = [
        f"{Path(frame.filename).resolve().relative_to(_ROOT)}:{frame.lineno}"
        for frame in traceback.extract_tb(error.__traceback__)
        if Path(frame.filename).resolve().is_relative_to(_ROOT)
        and "/trials/" not in frame.filename.replace(str(_ROOT), "")
    ]
    return f"{type(error).__name__}: {error} [{' < '.join(own[:-3:-1])}]".replace("\n", " ")
