"""What ends a worker process whose parent is gone."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable

__all__ = ["end_with_parent"]

_EVERY = 1.0  # [s] between two looks
_ORPHANED = 1  # exit status, that nobody is left to read


def end_with_parent(parent: int, last: Callable[[], None] | None = None) -> None:
    """In a worker: end this process soon after its parent has ended, however that came about.

    A process whose parent was killed is not told: it would wait for work that nobody sends, and hold memory
    and semaphores. A thread looks every second whose child this process is; when that changes, the process
    ends at once, without the clean-up that might wait for the parent.

    Parameters
    ----------
    parent : int
        Process id of the parent, as the parent itself knows it: it may be gone before this is called.
    last : callable, optional
        Called without arguments just before the end: removes what this process would leave behind.
    """
    threading.Thread(target=_watch, args=(parent, last), name="end-with-parent", daemon=True).start()


def _watch(parent: int, last: Callable[[], None] | None) -> None:
    while os.getppid() == parent:
        time.sleep(_EVERY)
    try:
        if last is not None:
            last()
    finally:
        os._exit(_ORPHANED)
