"""`outcomes`: many independent tasks, results in order, memory bounded, one failure harms no other task.

Each works on copies of its own, and gives a result or the error that it raised.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Generator, Iterable, Iterator
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from ffsms_pin.checks import instance, optional_callable, whole
from ffsms_pin.errors import TaskError, TasksFailed

T = TypeVar("T")
Work = Callable[[Any, Any], T]
# What is the same for all tasks: `work(shared, task)`, and `shared`.
Common = tuple[Callable[[Any, Any], Any], Any]
# Result and error of a task; one of them is None.
Answer = tuple[Any, Exception | None]


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


def outcomes(
    work: Work[T], shared: Any, tasks: Iterable[Any], jobs: int | None = None, largest_chunk: int = 16
) -> Generator[Outcome[T], None, None]:
    """Outcomes of `work(shared, task)`, in the order of the tasks, as they come.

    Parameters
    ----------
    work : callable
    shared : object
        Copied to each process; `work` must not change it.
    tasks : iterable
        May be endless: only a few tasks a process are taken ahead of what has been yielded. Each is worked on
        as a copy, also where there is only this process.
    jobs : int, optional
        Processes; 1 works in this one, without Dask. Default: one a core, or 1 where Dask is not installed.
    largest_chunk : int
        Tasks that are handed out together once there have been many of them.

    Raises
    ------
    InvalidValue
        `jobs` is no number of processes, or one cannot go through `tasks`.
    DependencyMissing
        Several processes are asked for, and Dask is not installed.
    ClusterError
        While going through the outcomes: the processes cannot be started.
    """
    from ffsms_pin.engine import kept  # what one process does without
    from ffsms_pin.engine.cluster import checked_jobs

    instance("tasks", tasks, Iterable)
    jobs = checked_jobs(jobs)
    if jobs == 1:
        return _here(work, shared, tasks)
    return kept.over(work, shared, tasks, jobs, largest_chunk)


def all_results(
    found: Iterator[Outcome[T]], count: int, progress: Callable[[float], None] | None = None
) -> list[T]:
    """The results of `count` tasks; if any failed, `TasksFailed` carries the others."""
    instance("found", found, Iterator)
    whole("count", count, 0)
    optional_callable("progress", progress)
    results: list[Any] = []
    failures: dict[int, Exception] = {}
    for outcome in found:
        instance("found", outcome, Outcome)
        results.append(outcome.result)
        if outcome.error is not None:
            failures[outcome.index] = outcome.error
        if progress is not None:
            progress(len(results) / max(count, 1))
    if failures:
        raise TasksFailed(failures, results)
    return results


def _here(work: Work[T], shared: Any, tasks: Iterable[Any]) -> Generator[Outcome[T], None, None]:
    common = _copied((work, shared))
    for index, task in enumerate(tasks):
        yield Outcome(index, *answer(common, lambda task=task: _copied(task)))  # type: ignore[misc]


@dataclass(frozen=True)
class Unsent:
    """Stands for a task or a result that cannot be pickled."""

    error: TaskError


def _copied(thing: Any) -> Any:
    """A copy that shares nothing with the original.

    cloudpickle copies what functions remember too, as on the way to a worker. Where it is not installed there
    are no workers that would have to come to the same, and functions stay what they are.
    """
    try:
        import cloudpickle
    except ImportError:
        return deepcopy(thing)
    return pickle.loads(cloudpickle.dumps(thing))


def answer(common: Common, task: Callable[[], Any]) -> Answer:
    """What became of the task that a function gives."""
    work, shared = common
    try:
        own = task()
        if isinstance(own, Unsent):
            return None, own.error
        return work(shared, own), None
    except Exception as error:
        return None, _portable(error)


def _portable(error: Exception) -> Exception:
    """The error, or its text where it does not survive being sent."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # likewise
        return told(error)
    return error


def told(error: Exception) -> TaskError:
    """An error as text."""
    return TaskError(f"{type(error).__name__}: {error}")
