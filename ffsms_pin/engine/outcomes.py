"""`outcomes`: many independent tasks, results in order, memory bounded, one failure harms no other task.

Each works on copies of its own, and gives a result or the error that it raised.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing
from copy import deepcopy
from dataclasses import dataclass
from itertools import islice
from typing import Any, Generic, TypeVar

from ffsms_pin.checks import instance, optional_callable, whole
from ffsms_pin.engine.cluster import Cluster, check_installed
from ffsms_pin.engine.kept import kept
from ffsms_pin.engine.run import checked_jobs
from ffsms_pin.engine.spread import Killed, spread
from ffsms_pin.engine.task import sent
from ffsms_pin.errors import TaskError, TasksFailed

__all__ = ["Outcome", "all_results", "outcomes"]

T = TypeVar("T")
Work = Callable[[Any, Any], T]
# What is the same for all tasks: `work(shared, task)`, and `shared`.
Common = tuple[Callable[[Any, Any], Any], Any]
# Result and error of a task; one of them is None.
Answer = tuple[Any, Exception | None]

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
    instance("tasks", tasks, Iterable)
    jobs = checked_jobs(jobs)
    if jobs == 1:
        return _here(work, shared, tasks)
    check_installed()
    return _over(work, shared, tasks, jobs, largest_chunk)


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
        yield Outcome(index, *_answer(common, lambda task=task: _copied(task)))  # type: ignore[misc]


@dataclass(frozen=True)
class _Chunk:
    """Tasks that are handed out together, and the index of the first."""

    first: int
    tasks: list[bytes]


def _over(
    work: Work[T], shared: Any, tasks: Iterable[Any], jobs: int, largest_chunk: int
) -> Generator[Outcome[T], None, None]:
    import cloudpickle

    common: bytes = cloudpickle.dumps((work, shared))
    chunks = _chunks(tasks, jobs, largest_chunk)
    early: dict[int, list[Answer]] = {}  # by their first index, those that ended before an earlier chunk
    following = 0  # index of the next outcome

    def ready() -> Iterator[Outcome[T]]:
        nonlocal following
        while following in early:
            for found in early.pop(following):
                yield Outcome(following, *found)
                following += 1

    def handed(chunk: _Chunk) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return sent, (_answers, common, chunk.tasks)

    with kept(jobs) as cluster:
        while True:
            killed: list[_Chunk] = []
            undisturbed = _until(killed, chunks)
            with closing(spread(cluster, undisturbed, handed, lambda: len(early))) as ended:
                for chunk, found in ended:
                    if isinstance(found, Killed):
                        killed.append(chunk)
                    else:
                        early[chunk.first] = [_unpacked(data) for data in found]
                        yield from ready()
            if not killed:
                return
            for chunk in killed:
                early[chunk.first] = [_alone(cluster, common, task) for task in chunk.tasks]
            yield from ready()


def _chunks(tasks: Iterable[Any], jobs: int, largest: int) -> Iterator[_Chunk]:
    """Chunks of tasks; they grow with the number handed out."""
    rest, first = iter(tasks), 0
    while chunk := list(islice(rest, min(largest, 1 + int(SHARE * first / jobs)))):
        yield _Chunk(first, [_packed(task) for task in chunk])
        first += len(chunk)


def _until(killed: list[_Chunk], chunks: Iterator[_Chunk]) -> Iterator[_Chunk]:
    """Chunks, as long as none has been given up: then those on their way come to their end first."""
    while not killed:
        chunk = next(chunks, None)
        if chunk is None:
            return
        yield chunk


def _alone(cluster: Cluster, common: bytes, task: bytes) -> Answer:
    """What comes of a task that was on its way to a worker that died, with nothing else on its way."""
    ((_, found),) = spread(cluster, [task], lambda one: (sent, (_answers, common, [one])))
    if isinstance(found, Killed):
        return None, TaskError("the process that worked on it died (out of memory?)")
    return _unpacked(found[0])


@dataclass(frozen=True)
class _Unsent:
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


def _packed(thing: Any) -> bytes:
    """A task or an answer as bytes; what cannot be pickled becomes its error."""
    import cloudpickle

    try:
        data: bytes = cloudpickle.dumps(thing)
    except Exception as error:  # whatever its class makes of being copied
        data = pickle.dumps(_Unsent(_told(error)))
    return data


def _answers(common: Common, tasks: list[bytes]) -> list[bytes]:
    """In a worker: what became of some tasks."""
    return [_packed(_answer(common, lambda data=data: pickle.loads(data))) for data in tasks]  # type: ignore[misc]


def _answer(common: Common, task: Callable[[], Any]) -> Answer:
    """What became of the task that a function gives."""
    work, shared = common
    try:
        own = task()
        if isinstance(own, _Unsent):
            return None, own.error
        return work(shared, own), None
    except Exception as error:
        return None, _portable(error)


def _unpacked(data: bytes) -> Answer:
    """The answer that a worker sent."""
    found = pickle.loads(data)
    return (None, found.error) if isinstance(found, _Unsent) else found


def _portable(error: Exception) -> Exception:
    """The error, or its text where it does not survive being sent."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # likewise
        return _told(error)
    return error


def _told(error: Exception) -> TaskError:
    return TaskError(f"{type(error).__name__}: {error}")
