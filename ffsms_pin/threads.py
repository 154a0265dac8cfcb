"""A limit to one BLAS thread, a lock for single-threaded objects, and a base class of constant objects."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

from ffsms_pin.errors import FfsmsError

_limited = threading.Lock()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit BLAS to one thread; also a decorator, `@one_blas_thread()`.

    The matrices are small, so a second thread costs more time than it saves. The limit applies to the whole
    process. Setting it takes 0.1 ms, so it is set for whole plans and simulations.
    """
    if not _limited.acquire(blocking=False):  # held by an outer call or by another thread
        yield
        return
    try:
        # SciPy has its own BLAS library, which the controller detects only after its import.
        with _controller("scipy.linalg" in sys.modules).limit(limits=1, user_api="blas"):
            yield
    finally:
        _limited.release()


@lru_cache(maxsize=2)
def _controller(with_scipy: bool) -> Any:
    """Return the controller of all loaded BLAS libraries, cached because it takes milliseconds to create."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


class InUse(FfsmsError, RuntimeError):
    """A single-threaded object is already in use, or reserved for another thread."""


class OneThread:
    """A context manager that can be entered only once at a time; a second entry raises `InUse`.

    This also holds for a nested entry by the same thread. Copies and unpickled objects are not reserved for a
    thread.

    Parameters
    ----------
    text : str
        The text of the error.
    for_good : bool
        True to reserve the object for the first thread that enters it, also after that thread leaves it.
    """

    def __init__(self, text: str, for_good: bool = False) -> None:
        self._text, self._for_good = text, for_good
        self._lock, self._thread = threading.Lock(), 0

    def __reduce__(self) -> tuple[Any, ...]:
        return OneThread, (self._text, self._for_good)

    def __enter__(self) -> None:
        own = threading.get_ident()
        if (self._for_good and self._thread not in (0, own)) or not self._lock.acquire(blocking=False):
            raise InUse(self._text)
        self._thread = own

    def __exit__(self, *error: object) -> None:
        self._lock.release()


class Unchanging:
    """The base class of objects whose attributes cannot be changed after construction.

    During construction, subclasses set attributes by `checks.set_frozen` or while `_complete` is False.
    """

    _complete = True
    _refused = "this cannot be changed (tried to {} '{}')"  # text of the error

    def __setattr__(self, name: str, value: object) -> None:
        if self._complete:
            raise AttributeError(self._refused.format("set", name))
        object.__setattr__(self, name, value)

    def __delattr__(self, name: str) -> None:
        raise AttributeError(self._refused.format("delete", name))
