"""What Dask must not lose, Ctrl-C, and what its log must not say: lost connections are an error of ours."""

from __future__ import annotations

import logging
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Lock, current_thread, main_thread
from types import FrameType

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_LOGGERS = ("distributed", "distributed.client", "tornado.application", "asyncio")
_OFF = logging.CRITICAL + 1
_lock = Lock()
_users = 0
_before: list[int] = []  # levels, while there are users


@contextmanager
def put_off(wake: Callable[[], object] | None = None) -> Iterator[None]:
    """Call the handlers of SIGINT and SIGTERM at the end of the block, not within it.

    What a handler raises in a `__del__` or in the callback of a weak reference, as Dask has them, Python
    prints and drops: the program goes on as if nobody had pressed Ctrl-C. The second signal within a block
    does not wait. `wake` is called when a signal is put off, to end what the block waits for. Threads other
    than the main one get no signals.
    """
    if current_thread() is not main_thread():
        yield
        return
    handlers: dict[int, Callable[[int, FrameType | None], object]] = {}
    came: list[tuple[int, FrameType | None]] = []

    def note(number: int, frame: FrameType | None) -> None:
        if came:
            came.clear()
            handlers[number](number, frame)
            return
        came.append((number, frame))
        if wake is not None:
            wake()

    try:
        for one in _SIGNALS:
            handler = signal.getsignal(one)
            if callable(handler):
                handlers[one] = handler
                signal.signal(one, note)
        yield
    finally:
        for number, handler in handlers.items():
            if signal.getsignal(number) is note:  # nobody has set another one within the block
                signal.signal(number, handler)
        for number, frame in came:
            handlers[number](number, frame)


@contextmanager
def quiet() -> Iterator[None]:
    """Switch the loggers off, until the last of several uses at a time has ended, in whatever order."""
    global _users
    loggers = [logging.getLogger(name) for name in _LOGGERS]
    with _lock:
        if _users == 0:
            _before[:] = [logger.level for logger in loggers]
        _users += 1
        for logger in loggers:
            logger.setLevel(_OFF)
    try:
        yield
    finally:
        with _lock:
            _users -= 1
            if _users == 0:
                for logger, level in zip(loggers, _before, strict=True):
                    logger.setLevel(level)
