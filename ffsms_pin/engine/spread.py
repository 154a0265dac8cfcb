"""Tasks over a cluster: a few ahead of what is done, workers that die, and tasks that kill them.

Tasks travel in pieces. Where workers died over a piece, halving it finds the tasks to blame.
"""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import closing
from functools import lru_cache
from queue import Empty, SimpleQueue
from typing import Any, TypeAlias
from uuid import uuid4

from ffsms_pin.engine.cluster import Cluster, put_off
from ffsms_pin.errors import ClusterError, FfsmsError, TaskError

AHEAD = 4  # pieces a worker that the scheduler holds: so many ride out a slow one, and N does not matter
_LOOK = 0.5  # [s] between two looks at the workers
_FETCH = 5.0  # [s] for a result to come from its worker
_PATIENCE = 60.0  # [s] without any worker

KILLED = "killed its worker"  # stands for the result of a piece over which its workers died
# Tasks that are handed out together: what can be cut in two.
Piece: TypeAlias = Sequence[Any]


def spread(
    cluster: Cluster,
    work: Callable[[Any], Any],
    pieces: Iterable[Piece],
    held: Callable[[], int] = lambda: 0,
) -> Generator[list[tuple[Any, Any]], None, None]:
    """Pieces, taken as they are needed, with what `work` gives for each, in the order in which they end.

    Each comes alone in a list, or where workers died over it, as its parts: that of a single task that kills
    its worker has the result `KILLED`. No more pieces are taken then until those on their way have ended, so
    that no other one can be to blame. `held` gives the number of results that are kept for a piece that has
    not ended: with them, no more pieces are taken than without. `ClusterError` where the scheduler is gone,
    or there are no workers; what a task raised is raised.
    """
    import cloudpickle

    packed, rest = cloudpickle.dumps(work), iter(pieces)
    while True:
        killed: list[Piece] = []
        undisturbed = iter(lambda: None if killed else next(rest, None), None)  # noqa: B023
        with closing(_ended(cluster, packed, undisturbed, held)) as ended:
            for piece, result in ended:
                if result is KILLED:
                    killed.append(piece)
                else:
                    yield [(piece, result)]
        if not killed:
            return
        for piece in killed:
            yield list(_parts(cluster, packed, piece))


def _parts(cluster: Cluster, packed: bytes, piece: Piece) -> Iterator[tuple[Piece, Any]]:
    """A piece that was given up, or its halves and so on, each alone on the cluster, and their results."""
    ((_, result),) = _ended(cluster, packed, [piece], lambda: 0)
    if result is not KILLED or len(piece) == 1:
        yield piece, result
        return
    middle = len(piece) // 2
    yield from _parts(cluster, packed, piece[:middle])
    yield from _parts(cluster, packed, piece[middle:])


def _ended(
    cluster: Cluster, packed: bytes, pieces: Iterable[Piece], held: Callable[[], int]
) -> Generator[tuple[Piece, Any], None, None]:
    """Pieces and their results; `KILLED` where Dask gave the piece up as its workers died.

    It need not be to blame: Dask counts a death against every task that was assigned to the worker.
    """
    rest, ended = iter(pieces), SimpleQueue[Any]()
    waiting: dict[str, tuple[Piece, Any]] = {}
    workers, seen = cluster.jobs, time.monotonic()
    looked = seen
    try:
        while True:
            room = AHEAD * max(workers, 1) - len(waiting) - held()
            for _, piece in zip(range(room), rest, strict=False):
                with put_off():
                    key = f"ffsms-pin-{uuid4().hex}"
                    future = cluster.client.submit(_called, packed, piece, key=key, pure=False)
                    future.add_done_callback(ended.put)  # it comes into the queue when it has ended
                    waiting[key] = piece, future
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
                    cluster.tend()
                    workers = cluster.workers()
                seen = now if workers or cluster.jobs else seen
                if now - seen > _PATIENCE:
                    raise ClusterError(
                        f"the scheduler at {cluster.address} has had no workers for {_PATIENCE:g} s; "
                        f"start some with: dask worker {cluster.address}"
                    )
    finally:
        for _, future in waiting.values():
            future.release()


def _next(
    cluster: Cluster, ended: SimpleQueue[Any], waiting: dict[str, tuple[Piece, Any]]
) -> tuple[Piece, Any] | None:
    """A piece that has ended, and its result; None where none ends within a while, or a signal came."""
    from distributed.scheduler import KilledWorker

    try:
        future = ended.get(timeout=_LOOK)
    except Empty:
        return None
    if future is None:
        return None
    result, status = KILLED, future.status
    if status == "finished":
        try:
            result = future.result(timeout=_FETCH)
            cluster.failed_starts = 0
        except OSError:  # its worker died meanwhile, or the scheduler did
            status = "lost"
        except CancelledError:
            status = "cancelled"
    if status in ("pending", "lost"):  # the scheduler has the task done again
        future.add_done_callback(ended.put)
        return None
    if status not in ("finished", "error"):  # cancelled, as all futures of a scheduler that is gone
        raise cluster.gone()
    if status == "error" and not isinstance(error := future.exception(), KilledWorker):
        raise error
    piece, _ = waiting.pop(future.key)
    future.release()
    return piece, result


def _called(packed: bytes, piece: Piece) -> Any:
    """In a worker: do work that came as bytes, so that a scheduler need not be able to import it.

    An error that would not survive the way back is sent as text.
    """
    try:
        return _unpacked(packed)(piece)
    except FfsmsError:
        raise
    except Exception as error:
        raise TaskError(f"{type(error).__name__}: {error}") from None


@lru_cache(maxsize=4)
def _unpacked(packed: bytes) -> Any:
    return pickle.loads(packed)
