"""`outcomes`: many independent tasks, results in order, memory bounded, one failure harms no other task.

Each works on copies of its own, and gives a result or the error that it raised. Where several processes work,
they wait a minute for the next call, which need not start them.
"""

from __future__ import annotations

import atexit
import os
import pickle
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing, contextmanager
from copy import deepcopy
from dataclasses import dataclass
from functools import partial
from itertools import islice
from threading import Timer
from typing import Any, Generic, TypeVar

from ffsms_pin.checks import instance, optional_callable, whole
from ffsms_pin.engine.cluster import Cluster, checked_jobs, quiet, started
from ffsms_pin.engine.spread import KILLED, spread
from ffsms_pin.errors import TaskError, TasksFailed

IDLE = 60.0  # [s] that workers wait for the next call
# A death is held against the few tasks of that worker at once: each is tried again alone.
_ALLOWED_FAILURES = 0
# A piece is at most this share of what is done already, so that the last ones end together.
_SHARE = 1.0 / 64.0

T = TypeVar("T")
Work = Callable[[Any, Any], T]


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
    """`outcomes` with this process."""
    work, shared = _copied((work, shared))
    for index, task in enumerate(tasks):
        yield Outcome(index, *_answer(work, shared, partial(_copied, task)))


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


def _answer(work: Work[T], shared: Any, task: Callable[[], Any]) -> tuple[T | None, Exception | None]:
    """Result and error of the task that a function gives; one of them is None."""
    try:
        return work(shared, task()), None
    except Exception as error:
        try:
            pickle.loads(pickle.dumps(error))
        except Exception:  # whatever its class makes of being copied
            return None, _as_text(error)
        return None, error


def _as_text(error: Exception) -> TaskError:
    return TaskError(f"{type(error).__name__}: {error}")


def _over(
    work: Work[T], shared: Any, tasks: Iterable[Any], jobs: int, largest: int
) -> Generator[Outcome[T], None, None]:
    """`outcomes` with several processes."""
    early: dict[int, list[Any]] = {}  # by their first index, those that ended before an earlier piece
    following = 0  # index of the next outcome
    answers, pieces = partial(_answers, work, shared), _pieces(tasks, jobs, largest)
    with (
        _kept(jobs) as cluster,
        closing(spread(cluster, answers, pieces, lambda: len(early))) as ended,
    ):
        for parts in ended:
            for piece, found in parts:
                if found is KILLED:
                    found = [TaskError("the process that worked on it died (out of memory?)")]
                early[piece[0][0]] = found
            while following in early:
                for one in early.pop(following):
                    result, error = (None, one) if isinstance(one, TaskError) else pickle.loads(one)
                    yield Outcome(following, result, error)
                    following += 1


def _pieces(tasks: Iterable[Any], jobs: int, largest: int) -> Iterator[list[tuple[int, bytes | TaskError]]]:
    """Pieces of tasks with their indices; they grow with the number handed out."""
    rest, first = enumerate(map(_packed, tasks)), 0
    while piece := list(islice(rest, min(largest, 1 + int(_SHARE * first / jobs)))):
        yield piece
        first += len(piece)


def _packed(thing: Any) -> bytes | TaskError:
    """A task or an answer as bytes; what cannot be pickled becomes its error."""
    import cloudpickle

    try:
        return bytes(cloudpickle.dumps(thing))
    except Exception as error:  # likewise
        return _as_text(error)


def _answers(work: Work[Any], shared: Any, piece: list[tuple[int, Any]]) -> list[bytes | TaskError]:
    """In a worker: what became of some tasks, as bytes."""
    return [
        task if isinstance(task, TaskError) else _packed(_answer(work, shared, partial(pickle.loads, task)))
        for _, task in piece
    ]


_open: set[Cluster] = set()  # those in use, and the one that waits
_waiting: dict[Timer, Cluster] = {}  # by what will end it


@contextmanager
def _kept(jobs: int) -> Iterator[Cluster]:
    """A cluster of `jobs` workers for one use; two uses at a time have two.

    It waits for a minute then, in case that the next use wants as many workers. It ends with the process, and
    after a use that ended with an error, Ctrl-C among them.
    """
    cluster = _taken(jobs)
    if cluster is None:
        with quiet:
            cluster = started(jobs, _ALLOWED_FAILURES)
        # Once Dask is there: what it does at the end of a process comes later then.
        atexit.unregister(_end_all)
        atexit.register(_end_all)
        _open.add(cluster)
    try:
        with quiet:
            cluster.tend()
            yield cluster
    except GeneratorExit:  # whoever asked for the results wants no more of them
        _put_back(cluster)
        raise
    except BaseException:
        _end(cluster)
        raise
    _put_back(cluster)


def end_kept() -> None:
    """End the cluster that waits, if there is one."""
    _taken()


def _taken(jobs: int = 0) -> Cluster | None:
    """The cluster that waits; one with another number of workers than the wanted one is ended."""
    for timer in list(_waiting):
        timer.cancel()
        cluster = _waiting.pop(timer, None)  # None: its time is over, or another thread has it
        if cluster is not None and cluster.jobs == jobs:
            return cluster
        _end(cluster)
    return None


def _put_back(cluster: Cluster) -> None:
    """Let a cluster wait; one that waits already is enough."""
    if cluster not in _open:  # the process ends, and its clusters have ended already
        return
    if _waiting:
        _end(cluster)
        return
    timer = Timer(IDLE, lambda: _end(_waiting.pop(timer, None)))
    timer.daemon = True
    _waiting[timer] = cluster
    timer.start()


def _end(cluster: Cluster | None) -> None:
    if cluster is not None:
        _open.discard(cluster)
        with quiet:
            cluster.end()


def _end_all() -> None:
    while _open:
        _end(next(iter(_open)))


# In a process that was forked: the clusters are its parent's.
os.register_at_fork(after_in_child=_open.clear)
os.register_at_fork(after_in_child=_waiting.clear)
