"""A stepper works for one thread at a time: a second one is refused."""

from __future__ import annotations

import threading
from types import TracebackType

from ffsms_pin.errors import FfsmsError

__all__ = ["OneAtATime", "StepperInUse"]


class StepperInUse(FfsmsError, RuntimeError):
    """Two threads use one `Stepper` at the same time; each has to have its own (`stepper.like()`)."""

    def __init__(self) -> None:
        super().__init__(
            "this Stepper is at work in another thread; give each thread one of its own: stepper.like()"
        )


class OneAtATime:
    """`with` it one thread is at work; another one that comes meanwhile gets `StepperInUse`."""

    def __init__(self) -> None:
        self._lock = threading.Lock()

    def __enter__(self) -> None:
        if not self._lock.acquire(blocking=False):
            raise StepperInUse

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._lock.release()
