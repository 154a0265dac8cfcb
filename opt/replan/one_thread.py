"""A reference with a memory is for one run at a time: a second thread is refused."""

from __future__ import annotations

import threading
from typing import Any

from ffsms_pin.errors import FfsmsError

__all__ = ["OneThread", "ReferenceInUse"]


class ReferenceInUse(FfsmsError, RuntimeError):
    """A second thread goes on with a `Replanning` that another one has begun."""

    def __init__(self) -> None:
        super().__init__(
            "another thread has begun to follow this Replanning, and it remembers one motion only;"
            " make one for each run: opt.Replanning(problem)"
        )


class OneThread:
    """The thread that uses an object: the first that calls `check`. A copy has none yet."""

    def __init__(self) -> None:
        self._ident: int | None = None
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[Any, ...]:
        return OneThread, ()

    def check(self) -> None:
        """Raise `ReferenceInUse` where another thread has called this before."""
        with self._lock:
            if self._ident is None:
                self._ident = threading.get_ident()
        if self._ident != threading.get_ident():
            raise ReferenceInUse
