"""One BLAS thread while the library works, so that results do not depend on how many there are.

And planners that remember something are for one thread: a second one is refused (`OneThread`). What any
thread may use does not change once it is made (`Unchanging`).

Two threads share out a product of matrices otherwise than one does, and so round otherwise; an optimisation
then ends at other digits. The matrices here are small: a second thread takes more time than it saves.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

from ffsms_pin.errors import FfsmsError


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Work with one BLAS thread; also a decorator, `@one_blas_thread()`.

    It takes some 15 microseconds, and 3 within another one. So it stands around whole plans and simulations;
    single steps have matrices so small that BLAS never shares them out.
    """
    _, own = _libraries()
    before = [library.num_threads for library in own]
    _set(own, [1] * len(own))
    try:
        with _limit:
            yield
    finally:
        _set(own, before)


class Shared:
    """`with` it something holds from the first of several uses at a time to the end of the last.

    If each use set back what it had found, one that ends would take it from another one that still goes on
    in another thread. `begin` makes it hold, and gives what sets back what it found.
    """

    def __init__(self, begin: Callable[[], Callable[[], None]]) -> None:
        self._begin, self._lock, self._uses = begin, threading.Lock(), 0
        self._end: Callable[[], None] = lambda: None

    def __enter__(self) -> None:
        with self._lock:
            if self._uses == 0:
                self._end = self._begin()
            self._uses += 1

    def __exit__(self, *error: object) -> None:
        with self._lock:
            self._uses -= 1
            if self._uses == 0:
                self._end()


def _limited() -> Callable[[], None]:
    """One thread for libraries that have one number of threads for the whole process."""
    shared, _ = _libraries()
    before = [library.num_threads for library in shared]
    _set(shared, [1] * len(shared))
    return lambda: _set(shared, before)


_limit = Shared(_limited)


@lru_cache(maxsize=1)
def _libraries() -> tuple[list[Any], list[Any]]:
    """The BLAS libraries of numpy and scipy (threadpoolctl's controllers); found once, in some milliseconds.

    Those whose number of threads holds for the whole process, and those where each thread has its own:
    OpenBLAS on OpenMP.
    """
    import scipy.linalg  # noqa: F401 - brings a library of its own, which must be there to be found
    from threadpoolctl import ThreadpoolController

    shared, own = list[Any](), list[Any]()
    for library in ThreadpoolController().select(user_api="blas").lib_controllers:
        on_openmp = library.internal_api == "openblas" and library.threading_layer == "openmp"
        (own if on_openmp else shared).append(library)
    return shared, own


def _set(libraries: list[Any], numbers: list[int]) -> None:
    for library, number in zip(libraries, numbers, strict=True):
        # From 3.8 on threadpoolctl heeds only the thread that was first to set a number, and only until told
        # otherwise. Here calls are counted instead, and whichever ends last sets it.
        release = getattr(library, "clear_controlling_thread", None)
        if release is not None:
            release(force=True)
        library.set_num_threads(number)
        if release is not None:
            release(force=True)


class InUse(FfsmsError, RuntimeError):
    """A second thread uses what is for one thread."""


class OneThread:
    """`with` it one thread is at work; another one that comes meanwhile is refused. A copy starts anew.

    Parameters
    ----------
    words : str
        Of the `InUse` that is raised.
    for_good : bool
        Whether the first thread is the only one, later as well.
    """

    def __init__(self, words: str, for_good: bool = False) -> None:
        self._words, self._for_good = words, for_good
        self._lock, self._thread = threading.Lock(), 0

    def __reduce__(self) -> tuple[Any, ...]:
        return OneThread, (self._words, self._for_good)

    def __enter__(self) -> None:
        own = threading.get_ident()
        if (self._for_good and self._thread not in (0, own)) or not self._lock.acquire(blocking=False):
            raise InUse(self._words)
        self._thread = own

    def __exit__(self, *error: object) -> None:
        self._lock.release()


class Unchanging:
    """What keeps its attributes once it is complete; of a class that always is, `checks.put` sets them."""

    _complete = True
    _refused = "this cannot be changed (tried to {} '{}')"  # what is said of a try to set, or to delete

    def __setattr__(self, name: str, value: object) -> None:
        if self._complete:
            raise AttributeError(self._refused.format("set", name))
        object.__setattr__(self, name, value)

    def __delattr__(self, name: str) -> None:
        raise AttributeError(self._refused.format("delete", name))
