"""Independent tasks over workers that wait a minute for the next call, which need not start them."""

from __future__ import annotations

import atexit
import os
import pickle
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing, contextmanager
from itertools import islice
from threading import Timer
from typing import Any, TypeAlias, TypeVar

from ffsms_pin.engine.cluster import Cluster, quiet, started
from ffsms_pin.engine.rows import sent
from ffsms_pin.engine.spread import Fate, spread
from ffsms_pin.engine.tasks import Answer, Common, Outcome, Unsent, answer, told
from ffsms_pin.errors import TaskError

IDLE = 60.0  # [s]
# A death is held against the few tasks of that worker at once: each is tried again alone.
_ALLOWED_FAILURES = 0
# A chunk is at most this share of what is done already, so that the last ones end together.
SHARE = 1.0 / 64.0

T = TypeVar("T")

_open: set[Cluster] = set()  # those in use, and the one that waits
_waiting: dict[Timer, Cluster] = {}  # by what will end it


@contextmanager
def kept(jobs: int) -> Iterator[Cluster]:
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


# Tasks that are handed out together, and the index of the first.
_Chunk: TypeAlias = tuple[int, list[bytes]]


def over(
    work: Callable[[Any, Any], T], shared: Any, tasks: Iterable[Any], jobs: int, largest_chunk: int
) -> Generator[Outcome[T], None, None]:
    """`outcomes` with several processes."""
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
        return sent, (_answers, common, chunk[1])

    with kept(jobs) as cluster:
        while True:
            killed: list[_Chunk] = []
            # As long as none has been given up: then those on their way come to their end first.
            undisturbed = iter(lambda: None if killed else next(chunks, None), None)  # noqa: B023
            with closing(spread(cluster, undisturbed, handed, lambda: len(early))) as ended:
                for chunk, found in ended:
                    if found is Fate.KILLED:
                        killed.append(chunk)
                    else:
                        early[chunk[0]] = [_unpacked(data) for data in found]
                        yield from ready()
            if not killed:
                return
            for first, tasks_of in killed:
                early[first] = [_alone(cluster, common, task) for task in tasks_of]
            yield from ready()


def _chunks(tasks: Iterable[Any], jobs: int, largest: int) -> Iterator[_Chunk]:
    """Chunks of tasks; they grow with the number handed out."""
    rest, first = iter(tasks), 0
    while chunk := list(islice(rest, min(largest, 1 + int(SHARE * first / jobs)))):
        yield first, [_packed(task) for task in chunk]
        first += len(chunk)


def _alone(cluster: Cluster, common: bytes, task: bytes) -> Answer:
    """What comes of a task that was on its way to a worker that died, with nothing else on its way."""
    ((_, found),) = spread(cluster, [task], lambda one: (sent, (_answers, common, [one])))
    if found is Fate.KILLED:
        return None, TaskError("the process that worked on it died (out of memory?)")
    return _unpacked(found[0])


def _packed(thing: Any) -> bytes:
    """A task or an answer as bytes; what cannot be pickled becomes its error."""
    import cloudpickle

    try:
        data: bytes = cloudpickle.dumps(thing)
    except Exception as error:  # whatever its class makes of being copied
        data = pickle.dumps(Unsent(told(error)))
    return data


def _answers(common: Common, tasks: list[bytes]) -> list[bytes]:
    """In a worker: what became of some tasks."""
    return [_packed(answer(common, lambda data=data: pickle.loads(data))) for data in tasks]  # type: ignore[misc]


def _unpacked(data: bytes) -> Answer:
    """The answer that a worker sent."""
    found = pickle.loads(data)
    return (None, found.error) if isinstance(found, Unsent) else found
