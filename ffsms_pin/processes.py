"""Parallel work in several processes on one machine."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from copy import deepcopy
from functools import partial
from typing import Any, TypeVar, cast

from ffsms_pin.checks import optional_callable, whole
from ffsms_pin.errors import TaskError, TasksFailed

T = TypeVar("T")
_Attempt = tuple[T | None, Exception | None]  # the result of a task, or the error that it raised


def usable_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def map_in_processes(
    work: Callable[[Any], T],
    tasks: Sequence[Any],
    jobs: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[T]:
    """Return the results of `work(task)` in the order of the tasks; `work` gets a copy of each task.

    Parameters
    ----------
    work : callable
        A module-level function, or a partial of one.
    tasks : sequence
        The arguments of `work`.
    jobs : int, optional
        The largest number of processes; 1 uses this process. Default: the number of cores.
    progress : callable, optional
        A function that is called with the completed share of the tasks, 0 to 1.

    Raises
    ------
    TasksFailed
        Some tasks raised errors; the exception has these errors and the results of the other tasks.
    TaskError
        A task cannot be sent to another process, or its process died.
    """
    optional_callable("progress", progress)
    jobs = min(usable_cores() if jobs is None else whole("jobs", jobs, 1, 1024), len(tasks))
    size = 1 if jobs <= 1 else min(16, 1 + len(tasks) // (8 * jobs))
    chunks = [tasks[i : i + size] for i in range(0, len(tasks), size)]
    attempt = partial(_attempts, work)
    attempts: list[_Attempt[T]] = []
    for ended in map(attempt, chunks) if jobs <= 1 else _in_pool(attempt, chunks, jobs):
        attempts += ended
        if progress is not None:
            progress(len(attempts) / len(tasks))
    results: list[Any] = [result for result, _ in attempts]
    if failures := {i: error for i, (_, error) in enumerate(attempts) if error is not None}:
        raise TasksFailed(failures, results)
    return results


def _attempts(work: Callable[[Any], T], tasks: Sequence[Any]) -> list[_Attempt[T]]:
    """Return the result or the error of each task of a chunk."""
    attempts: list[_Attempt[T]] = []
    for task in tasks:
        try:
            attempts.append((work(deepcopy(task)), None))
        except Exception as error:
            attempts.append((None, error))
    return attempts


def _in_pool(
    attempt: Callable[[Any], list[_Attempt[T]]], chunks: Sequence[Any], jobs: int
) -> Iterator[list[_Attempt[T]]]:
    """Yield the results of `attempt(chunk)` in the order of the chunks.

    Raises `TaskError` if a process dies or a task cannot be sent.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["ffsms_pin.opt", "ffsms_pin.simulation"])
    with ProcessPoolExecutor(jobs, context, _begin) as pool:
        # If workers die while tasks wait, old versions of Python 3.11 would wait forever for the thread that
        # sends tasks (CPython, issue gh-94777).
        internals = cast(Any, pool)
        internals._call_queue.cancel_join_thread()
        try:
            for future in [pool.submit(attempt, chunk) for chunk in chunks]:
                yield future.result()
        except BrokenProcessPool:
            raise TaskError(
                "a worker process died, because memory ran out, or because the script calls this function "
                "without `if __name__ == '__main__':` (not needed with jobs=1)"
            ) from None
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise TaskError(f"a task cannot be sent to another process ({error}); use jobs=1") from None
        except BaseException:  # such as Ctrl-C, which must not wait for running tasks
            for process in pool._processes.values():
                process.kill()
            # Otherwise the pool waits forever for the rest of a result that a killed process sent in part.
            internals._result_queue._writer.close()
            raise


def _begin() -> None:
    """Ignore Ctrl-C, which the parent process handles, and end this process when the parent ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
