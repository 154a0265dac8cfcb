"""Many independent tasks over processes: results in order, memory bounded, one failure harms no other task.

Pinocchio holds Python's lock, so threads would not help. The processes are loky's: they start fresh (nothing
is forked), need no `if __name__ == "__main__"`, take lambdas and classes of a notebook, and are kept for a
minute, so that a second call need not wait for them to start.
"""

from __future__ import annotations

import os
import pickle
import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, Future
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from typing import Any, Generic, TypeVar

from ffsms_pin.errors import InvalidValue, TaskError, TasksFailed
from ffsms_pin.parent import end_with_parent

__all__ = ["Outcome", "all_results", "outcomes", "usable_cores"]

T = TypeVar("T")
Work = Callable[[Any, Any], T]

IDLE = 60.0  # [s] after which a process that has nothing to do ends
# One thread a process: a second one would only take the core that another process works on.
ONE_THREAD = {
    f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "BLIS", "VECLIB_MAXIMUM", "NUMEXPR")
}
# Chunks handed out before the first of them is asked for, a process: enough to ride out one slow task.
AHEAD = 4
_MOST_JOBS = 1024  # processes
# A chunk is at most this share of what is done already, so that the last ones end together.
SHARE = 1.0 / 64.0


@dataclass(frozen=True)
class Outcome(Generic[T]):
    """What came of one task.

    Attributes
    ----------
    index : int
        Place of the task in the sequence, from 0.
    result : object or None
        None where the task failed.
    error : Exception or None
        Why it failed.
    """

    index: int
    result: T | None = None
    error: Exception | None = None


def usable_cores() -> int:
    """Number of cores that this process may use."""
    import loky

    return int(loky.cpu_count())


def outcomes(
    work: Work[T], shared: Any, tasks: Iterable[Any], jobs: int | None = None, largest_chunk: int = 16
) -> Iterator[Outcome[T]]:
    """Outcomes of `work(shared, task)`, in the order of the tasks, as they come.

    Parameters
    ----------
    work : callable
    shared : object
        Copied once to each process; `work` must not change it.
    tasks : iterable
        May be endless: only a few tasks a process are taken ahead of what has been yielded. Each is worked on
        as a copy, also where there is only this process.
    jobs : int, optional
        Processes; 1 works in this one. Default: as many as there are cores to use.
    largest_chunk : int
        Tasks that are handed out together once there have been many of them.
    """
    jobs = usable_cores() if jobs is None else _checked(jobs)
    return _outcomes(work, shared, tasks, jobs, largest_chunk)


def all_results(
    found: Iterator[Outcome[T]], count: int, progress: Callable[[float], None] | None = None
) -> list[T]:
    """The results of `count` tasks; if any failed, `TasksFailed` carries the others."""
    if progress is not None and not callable(progress):
        raise InvalidValue("progress", progress, "must be a function or None")
    results: list[Any] = []
    failures: dict[int, Exception] = {}
    for outcome in found:
        results.append(outcome.result)
        if outcome.error is not None:
            failures[outcome.index] = outcome.error
        if progress is not None:
            progress(len(results) / count)
    if failures:
        raise TasksFailed(failures, results)
    return results


def _outcomes(
    work: Work[T], shared: Any, tasks: Iterable[Any], jobs: int, largest_chunk: int
) -> Iterator[Outcome[T]]:
    import cloudpickle

    common: bytes = cloudpickle.dumps((work, shared))
    chunks = _chunks(tasks, jobs, largest_chunk)
    if jobs == 1:
        for first, chunk in chunks:
            yield from _unpacked(first, _run(common, cloudpickle.dumps(chunk)))
        return
    waiting: deque[tuple[int, bytes, Future[bytes]]] = deque()
    try:
        for first, chunk in chunks:
            packed: bytes = cloudpickle.dumps(chunk)
            waiting.append((first, packed, _submit(jobs, common, packed)))
            if len(waiting) == AHEAD * jobs:
                yield from _next(waiting, common)
        while waiting:
            yield from _next(waiting, common)
    except KeyboardInterrupt:
        _pool(jobs).shutdown(wait=True, kill_workers=True)
        raise
    finally:  # also where whoever asked for the outcomes wants no more of them
        for _, _, future in waiting:
            future.cancel()


def _next(waiting: deque[tuple[int, bytes, Future[bytes]]], common: bytes) -> Iterator[Outcome[Any]]:
    """Outcomes of the chunk that has waited longest."""
    first, _, future = waiting[0]
    try:
        answer = future.result()
    except BrokenExecutor:
        # A process died (out of memory, a crash in compiled code), and all chunks on their way with it. Each
        # task is tried once more alone, so that only the one to blame fails.
        broken = list(waiting)
        waiting.clear()
        for start, chunk, future in broken:
            yield from _finished(start, future) or _one_by_one(start, chunk, common)
        return
    waiting.popleft()
    yield from _unpacked(first, answer)


def _finished(first: int, future: Future[bytes]) -> list[Outcome[Any]]:
    """Outcomes of a chunk that was done before its process died; none where it was not."""
    if not future.done() or future.cancelled() or future.exception() is not None:
        return []
    return list(_unpacked(first, future.result()))


def _one_by_one(first: int, packed: bytes, common: bytes) -> Iterator[Outcome[Any]]:
    import cloudpickle

    for index, task in enumerate(pickle.loads(packed), first):
        try:
            answer = _submit(1, common, cloudpickle.dumps([task])).result()
        except BrokenExecutor:  # noqa: PERF203 - a failed task must not end the loop
            yield Outcome(index, error=TaskError("the process that worked on it died (out of memory?)"))
        else:
            yield from _unpacked(index, answer)


def _chunks(tasks: Iterable[Any], jobs: int, largest: int) -> Iterator[tuple[int, list[Any]]]:
    """Chunks of tasks with the index of their first; they grow with the number handed out."""
    rest, first = iter(tasks), 0
    while chunk := list(islice(rest, min(largest, 1 + int(SHARE * first / jobs)))):
        yield first, chunk
        first += len(chunk)


def _pool(jobs: int) -> Any:
    import loky

    return loky.get_reusable_executor(
        jobs, timeout=IDLE, env=ONE_THREAD, initializer=_begin, initargs=(os.getpid(),)
    )


def _submit(jobs: int, common: bytes, packed: bytes) -> Future[bytes]:
    future: Future[bytes] = _pool(jobs).submit(_run, common, packed)
    return future


def _begin(parent: int) -> None:
    """In a worker: Ctrl-C is for the process that the user started; it ends the workers, dead or alive."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent(parent)


@lru_cache(maxsize=4)
def _common(packed: bytes) -> Any:
    return pickle.loads(packed)


def _run(common: bytes, packed: bytes) -> bytes:
    """Outcomes of a chunk, as (result, error) pairs."""
    import cloudpickle

    work, shared = _common(common)
    done: list[tuple[Any, Exception | None]] = []
    for task in pickle.loads(packed):
        try:
            done.append((work(shared, task), None))
        except Exception as error:  # noqa: PERF203 - likewise
            done.append((None, _portable(error)))
    answer: bytes = cloudpickle.dumps(done)
    return answer


def _unpacked(first: int, answer: bytes) -> Iterator[Outcome[Any]]:
    for index, (result, error) in enumerate(pickle.loads(answer), first):
        yield Outcome(index, result, error)


def _portable(error: Exception) -> Exception:
    """The error, or its text where it does not survive being sent."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # whatever its class makes of being copied
        return TaskError(f"{type(error).__name__}: {error}")
    return error


def _checked(jobs: Any) -> int:
    if isinstance(jobs, bool) or not isinstance(jobs, int) or jobs < 1:
        raise InvalidValue("jobs", jobs, "must be a whole number above zero, or None for one a core")
    if jobs > _MOST_JOBS:
        raise InvalidValue("jobs", jobs, f"must not exceed {_MOST_JOBS}")
    return jobs
