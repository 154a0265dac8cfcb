"""Planners that remember something are for one thread: a second one is refused."""

from __future__ import annotations

import threading
from types import TracebackType
from typing import Any

from ffsms_pin.errors import FfsmsError

__all__ = ["OneThread", "ReferenceInUse", "StepperInUse"]


class StepperInUse(FfsmsError, RuntimeError):
    """Two threads use one `Stepper` at the same time; each has to have its own (`stepper.like()`)."""

    def __init__(self) -> None:
        super().__init__(
            "this Stepper is at work in another thread; give each thread one of its own: stepper.like()"
        )


class ReferenceInUse(FfsmsError, RuntimeError):
    """A second thread goes on with a `Replanning` that another one has begun."""

    def __init__(self) -> None:
        super().__init__(
            "another thread has begun to follow this Replanning, and it remembers one motion only;"
            " make one for each run: opt.Replanning(problem)"
        )


class OneThread:
    """`with` it one thread is at work; another one that comes meanwhile is refused. A copy starts anew.

    Parameters
    ----------
    refusal : type
        What is raised, without arguments.
    for_good : bool
        Whether the first thread is the only one, later as well.
    """

    def __init__(self, refusal: type[FfsmsError], for_good: bool = False) -> None:
        self._refusal, self._for_good = refusal, for_good
        self._lock, self._thread = threading.Lock(), 0

    def __reduce__(self) -> tuple[Any, ...]:
        return OneThread, (self._refusal, self._for_good)

    def __enter__(self) -> None:
        own = threading.get_ident()
        if (self._for_good and self._thread not in (0, own)) or not self._lock.acquire(blocking=False):
            raise self._refusal()
        self._thread = own

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._lock.release()
