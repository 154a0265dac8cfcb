"""`quiet`: keeps Dask's log of lost connections off the error stream. What matters is an error of ours."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock

__all__ = ["quiet"]

_LOGGERS = ("distributed", "distributed.client", "tornado.application", "asyncio")
_OFF = logging.CRITICAL + 1
_lock = Lock()
_users = 0
_before: list[int] = []  # levels, while there are users


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
