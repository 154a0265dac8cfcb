"""What a trial came to: a result, an error of the library's own, or a fault."""

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
    """What is tried, in words, and the trial itself."""

    what: str
    work: Callable[[], Any]


class Verdict(NamedTuple):
    """How a trial ended.

    Attributes
    ----------
    kind : str
        Of trial: "urdfs", "scenarios", "calls" or "kills".
    seed : int
    what : str
        What was tried.
    outcome : str
        One of `GOOD`, or "other error", "warning", "memory", "hang", "crash".
    detail : str
        The error, and the place of the project's code where it came up.
    """

    kind: str
    seed: int
    what: str
    outcome: str
    detail: str


def judged(work: Callable[[], Any]) -> tuple[str, str]:
    """Outcome and detail of a trial that neither hangs nor crashes."""
    try:
        work()
    except FfsmsError as error:
        return _of_ours(error)
    except Warning as warning:
        return "warning", _told(warning)
    except MemoryError as error:
        return "memory", _told(error)
    except BaseException as error:
        return "other error", _told(error)
    return "result", ""


def _of_ours(error: FfsmsError) -> tuple[str, str]:
    line = str(error)
    if not line.strip() or "\n" in line:
        return "other error", f"the text of {type(error).__name__} is not one line: {line!r}"
    if isinstance(error, TasksFailed):
        for one in error.failures.values():
            if not isinstance(one, FfsmsError):
                return "other error", f"in another process: {type(one).__name__}: {one}"
    return "our error", f"{type(error).__name__}: {line}"


def _told(error: BaseException) -> str:
    """Class, text, and the innermost places in the project's own files."""
    own = [
        f"{Path(frame.filename).resolve().relative_to(_ROOT)}:{frame.lineno}"
        for frame in traceback.extract_tb(error.__traceback__)
        if Path(frame.filename).resolve().is_relative_to(_ROOT)
        and "/trials/" not in frame.filename.replace(str(_ROOT), "")
    ]
    return f"{type(error).__name__}: {error} [{' < '.join(own[:-3:-1])}]".replace("\n", " ")
