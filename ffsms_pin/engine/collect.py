"""`collected`: rows of work into memory, for results that are small and wanted at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ffsms_pin.checks import instance
from ffsms_pin.engine.chunks import Chunks
from ffsms_pin.engine.cluster import Cluster, embedded
from ffsms_pin.engine.halving import Lost, halved
from ffsms_pin.engine.run import checked_jobs
from ffsms_pin.engine.spread import Killed, spread
from ffsms_pin.engine.task import Work, computed, joined, sent

__all__ = ["collected"]


def collected(
    work: Work,
    chunks: Chunks,
    *,
    jobs: int | None = None,
    lost: Lost | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """One table of all rows, in their order; nothing is written. Arguments and errors are those of `run`."""
    instance("chunks", chunks, Chunks)
    jobs = min(checked_jobs(jobs), len(chunks))
    tables: dict[int, dict[str, Any]] = {}
    finished = 0

    def take(index: int, table: dict[str, Any]) -> None:
        nonlocal finished
        tables[index] = table
        finished += len(chunks.rows_of(index))
        if progress is not None:
            progress(finished, chunks.rows)

    if progress is not None:
        progress(0, chunks.rows)
    if jobs == 1:
        for index in range(len(chunks)):
            take(index, computed(work, chunks.rows_of(index)))
    else:
        with embedded(jobs) as cluster:
            _spread(cluster, work, chunks, lost, take)
    return joined([tables[index] for index in range(len(chunks))])


def _spread(
    cluster: Cluster,
    work: Work,
    chunks: Chunks,
    lost: Lost | None,
    take: Callable[[int, dict[str, Any]], None],
) -> None:
    """Take every chunk's table; those whose workers died come last."""
    import cloudpickle

    packed: bytes = cloudpickle.dumps(work)
    suspects: list[int] = []
    tasks = spread(
        cluster, range(len(chunks)), lambda index: (sent, (computed, packed, chunks.rows_of(index)))
    )
    for index, result in tasks:
        if isinstance(result, Killed):
            suspects.append(index)
        else:
            take(index, dict(result))
    for index in suspects:
        take(index, halved(cluster, packed, chunks.rows_of(index), lost))
