"""Independent tasks over workers that wait a minute for the next call, which need not start them."""

from __future__ import annotations

import atexit
import os
import pickle
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing, contextmanager
from itertools import islice
from threading import Lock, Timer
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


class _Clusters:
    """The clusters of this process: one that waits, and those that are in use."""

    def __init__(self) -> None:
        self.lock = Lock()
        self.open: set[Cluster] = set()
        self.waiting: Cluster | None = None
        self.timer: Timer | None = None
        self.registered = False  # what ends them with the process


_clusters = _Clusters()


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
        # Once the first cluster is there: what Dask does at the end of a process comes after this then.
        if not _clusters.registered:
            atexit.register(_end_all)
            _clusters.registered = True
        _clusters.open.add(cluster)
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
    if (cluster := _taken()) is not None:
        _end(cluster)


def _taken(jobs: int = 0) -> Cluster | None:
    """The cluster that waits; one with another number of workers than the wanted one is ended."""
    with _clusters.lock:
        cluster, _clusters.waiting = _clusters.waiting, None
        if _clusters.timer is not None:
            _clusters.timer.cancel()
    if cluster is None or jobs in (0, cluster.jobs):
        return cluster
    _end(cluster)
    return None


def _put_back(cluster: Cluster) -> None:
    """Let a cluster wait; one that waits already is enough."""
    if cluster not in _clusters.open:  # the process ends, and its clusters have ended already
        return
    with _clusters.lock:
        if waits := _clusters.waiting is None:
            _clusters.waiting = cluster
            _clusters.timer = Timer(IDLE, _end_idle, (cluster,))
            _clusters.timer.daemon = True
            _clusters.timer.start()
    if not waits:
        _end(cluster)


def _end_idle(cluster: Cluster) -> None:
    with _clusters.lock:
        if _clusters.waiting is not cluster:
            return
        _clusters.waiting = None
    _end(cluster)


def _end(cluster: Cluster) -> None:
    _clusters.open.discard(cluster)
    with quiet:
        cluster.end()


def _end_all() -> None:
    while _clusters.open:
        _end(next(iter(_clusters.open)))


def _forget() -> None:
    """In a process that was forked: the clusters are its parent's."""
    global _clusters
    _clusters = _Clusters()


os.register_at_fork(after_in_child=_forget)


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
