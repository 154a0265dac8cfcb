"""Tasks over a cluster: a few ahead of what is done, workers that die, and tasks that kill them.

Where workers died over a chunk of rows, halving it finds the rows to blame.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import CancelledError
from enum import Enum
from queue import Empty, SimpleQueue
from typing import Any
from uuid import uuid4

from ffsms_pin.engine.cluster import Cluster, put_off
from ffsms_pin.engine.rows import Chunks, Table, Work, computed, halves, joined, sent, stored
from ffsms_pin.errors import ClusterError, TaskError

AHEAD = 4  # tasks a worker that the scheduler holds: so many ride out a slow one, and N does not matter
_LOOK = 0.5  # [s] between two looks at the workers
_FETCH = 5.0  # [s] for a result to come from its worker
_PATIENCE = 60.0  # [s] without any worker

KILLED = "killed its worker"
# The table that stands for a row (its number, what happened) that kills its worker.
Lost = Callable[[int, str], Table]
# Submits one task: given its arguments, a function and the rest of its arguments.
Submit = Callable[[Any], tuple[Callable[..., Any], tuple[Any, ...]]]


class Fate(Enum):
    """Stands for the result of a task."""

    KILLED = "it killed its workers"
    LOST = "the worker that held it died: the scheduler has the task done again"


def spread(
    cluster: Cluster, tasks: Iterable[Any], submit: Submit, held: Callable[[], int] = lambda: 0
) -> Generator[tuple[Any, Any], None, None]:
    """Tasks, taken as they are needed, and their results, in the order in which they end.

    The result is `Fate.KILLED` where Dask gave the task up as its workers died. It need not be to blame: Dask
    counts a death against every task that was assigned to the worker. `held` gives the number of results that
    are kept for a task that has not ended: with them, no more tasks are taken than without. `ClusterError`
    where the scheduler is gone, or there are no workers; what a task raised is raised.
    """
    rest, run = iter(tasks), uuid4().hex
    ended: SimpleQueue[Any] = SimpleQueue()
    waiting: dict[str, tuple[Any, Any]] = {}
    number, workers = 0, cluster.jobs
    seen = looked = time.monotonic()
    try:
        while True:
            room = AHEAD * max(workers, 1) - len(waiting) - held()
            for _, task in zip(range(room), rest, strict=False):
                with put_off():
                    key = f"ffsms-pin-{run}-{number}"
                    number += 1
                    function, arguments = submit(task)
                    future = cluster.client.submit(function, *arguments, key=key, pure=False)
                    future.add_done_callback(ended.put)  # it comes into the queue when it has ended
                    waiting[key] = task, future
            if not waiting:
                return
            with put_off(lambda: ended.put(None)):
                found = _next(cluster, ended, waiting)
            if found is not None:
                yield found
            now = time.monotonic()
            if now - looked >= _LOOK:
                looked = now
                with put_off():
                    if cluster.embedded:
                        cluster.tend()
                    workers = cluster.workers()
                seen = now if workers or cluster.embedded else seen
                if now - seen > _PATIENCE:
                    raise ClusterError(
                        f"the scheduler at {cluster.address} has had no workers for {_PATIENCE:g} s; "
                        f"start some with: dask worker {cluster.address}"
                    )
    finally:
        for _, future in waiting.values():
            future.release()


def _next(
    cluster: Cluster, ended: SimpleQueue[Any], waiting: dict[str, tuple[Any, Any]]
) -> tuple[Any, Any] | None:
    """A task that has ended, and its result; None where none ends within a while."""
    try:
        future = ended.get(timeout=_LOOK)
    except Empty:
        return None
    if future is None:  # a signal came
        return None
    result = _result(cluster, future)
    if result is Fate.LOST:
        future.add_done_callback(ended.put)
        return None
    if result is not Fate.KILLED:
        cluster.worked()
    task, _ = waiting.pop(future.key)
    future.release()
    return task, result


def _result(cluster: Cluster, future: Any) -> Any:
    """What a future came to."""
    from distributed.scheduler import KilledWorker

    if future.status == "finished":
        try:
            return future.result(timeout=_FETCH)
        except OSError:  # its worker died meanwhile, or the scheduler did
            return Fate.LOST
        except CancelledError:
            raise cluster.gone() from None
    if future.status in ("pending", "lost"):
        return Fate.LOST
    if future.status != "error":  # cancelled, as all futures of a scheduler that is gone
        raise cluster.gone()
    error = future.exception()
    if isinstance(error, KilledWorker):
        return Fate.KILLED
    raise error


def chunk_results(
    cluster: Cluster,
    work: Work,
    chunks: Chunks,
    indices: Iterable[int],
    written: Callable[[int], tuple[Any, ...]],
    lost: Lost | None,
) -> Iterator[tuple[int, Any]]:
    """Chunks, each with None once its worker has `stored` it, or with the table that halving found.

    `written` gives a chunk's file and the run. Those whose workers died come when all others are done.
    """
    import cloudpickle

    packed: bytes = cloudpickle.dumps(work)
    suspects: list[int] = []

    def task(index: int) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return sent, (stored, packed, chunks.rows_of(index), *written(index))

    for index, result in spread(cluster, indices, task):
        if result is Fate.KILLED:
            suspects.append(index)
        else:
            yield index, result
    for index in suspects:
        yield index, _halved(cluster, packed, chunks.rows_of(index), lost)


def _halved(cluster: Cluster, packed: bytes, rows: range, lost: Lost | None) -> dict[str, Any]:
    """The table of rows that were given up; each part is alone on the cluster: no other task is to blame.

    `TaskError` where one row kills its worker, and there is nothing to stand for it.
    """
    ((_, result),) = spread(cluster, [rows], lambda part: (sent, (computed, packed, part)))
    if result is not Fate.KILLED:
        return dict(result)
    if len(rows) > 1:
        return joined([_halved(cluster, packed, part, lost) for part in halves(rows)])
    if lost is None:
        raise TaskError(f"row {rows.start} {KILLED} (out of memory, or a crash in compiled code)")
    table = lost(rows.start, KILLED)
    return computed(lambda _: table, rows)
