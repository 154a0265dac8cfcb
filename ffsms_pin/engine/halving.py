"""Chunks over a cluster. Where workers died over one, halving it finds the rows to blame."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

from ffsms_pin.engine.chunks import Chunks, halves
from ffsms_pin.engine.cluster import Cluster
from ffsms_pin.engine.spread import Killed, spread
from ffsms_pin.engine.task import Table, Work, computed, joined, sent
from ffsms_pin.errors import TaskError

__all__ = ["KILLED", "Lost", "chunk_results"]

KILLED = "killed its worker"

Lost = Callable[[int, str], Table]


def chunk_results(
    cluster: Cluster,
    work: Work,
    chunks: Chunks,
    indices: Iterable[int],
    function: Callable[..., Any],
    others: Callable[[int], tuple[Any, ...]],
    lost: Lost | None,
) -> Iterator[tuple[int, Any]]:
    """Chunks, each with what `function(work, rows, *others(index))` gave, or the table that halving found.

    Those whose workers died come when all others are done.
    """
    import cloudpickle

    packed: bytes = cloudpickle.dumps(work)
    suspects: list[int] = []

    def task(index: int) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return sent, (function, packed, chunks.rows_of(index), *others(index))

    for index, result in spread(cluster, indices, task):
        if isinstance(result, Killed):
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
    if not isinstance(result, Killed):
        return dict(result)
    if len(rows) > 1:
        return joined([_halved(cluster, packed, part, lost) for part in halves(rows)])
    if lost is None:
        raise TaskError(f"row {rows.start} {KILLED} (out of memory, or a crash in compiled code)")
    table = lost(rows.start, KILLED)
    return computed(lambda _: table, rows)
