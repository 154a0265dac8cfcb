"""`run`: rows of work into a folder of chunk files."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ffsms_pin.checks import instance, optional_callable, whole
from ffsms_pin.engine.chunks import Chunks, Shard
from ffsms_pin.engine.cluster import ALLOWED_FAILURES, MOST_JOBS, Cluster, connected, embedded, usable_cores
from ffsms_pin.engine.folder import ChunkFolder
from ffsms_pin.engine.halving import Lost, halved
from ffsms_pin.engine.spread import Killed, spread
from ffsms_pin.engine.task import Work, save_table, sent, stored
from ffsms_pin.errors import InvalidValue, ResultError

__all__ = ["checked_jobs", "run"]


def run(
    work: Work,
    chunks: Chunks,
    folder: str | os.PathLike[str],
    *,
    specification: Mapping[str, Any],
    where: Mapping[str, str] | None = None,
    jobs: int | None = None,
    scheduler: str | None = None,
    shard: Shard | None = None,
    lost: Lost | None = None,
    prepare: Callable[[], None] | None = None,
    progress: Callable[[int, int], None] | None = None,
    allowed_failures: int = ALLOWED_FAILURES,
) -> ChunkFolder:
    """Compute rows in chunks, and write one file a chunk; what is there already is not computed again.

    A file counts where it names the run and its rows and its checksum is right; another one is computed
    again. The same call goes on where a run was killed. The files depend on `work` alone, as long as it gives
    a row the same values whatever the other rows of its chunk.

    Parameters
    ----------
    work : callable
        Gives the table of a range of rows: arrays by name, each with one entry a row, of numbers or text. It
        is pickled, so it may be a function, a frozen dataclass with `__call__`, or a class of a notebook.
    chunks : Chunks
        The rows, and how many of them make a chunk.
    folder : path
        Is made as needed. Workers on other machines must see it under the same path.
    specification : mapping
        Everything that the result depends on, for JSON: a run with another one is refused.
    where : mapping of str to str, optional
        Where things are that it does not depend on: a file that was moved is the same file.
    jobs : int, optional
        Workers on this machine; 1 works in this process, without Dask. Default: one a core.
    scheduler : str, optional
        Address of a Dask scheduler that stands, as tcp://host:8786; its workers work, and `jobs` has no use.
    shard : Shard, optional
        Work on every N-th chunk only, in this process, without Dask: for job arrays.
    lost : callable
        Gives the one-row table that stands for a row (its number, what happened) that kills its worker.
        Default: such a row ends the run with `TaskError`. Only other processes can be lost: in this one,
        such a row ends the run itself.
    prepare : callable, optional
        Called in this process before the first chunk, while the workers start; not at all where every chunk
        is there.
    progress : callable, optional
        Called with the number of rows done and of all rows of this call.
    allowed_failures : int
        Deaths of workers after which Dask gives up a task; for the embedded cluster only.

    Returns
    -------
    ChunkFolder

    Raises
    ------
    InvalidValue
        Arguments that do not fit together.
    ResultError
        The folder cannot be written, is full, or holds another specification.
    ClusterError
        The scheduler is not there or goes away, or workers cannot be started.
    DependencyMissing
        Several processes are asked for, and Dask is not installed.
    FfsmsError
        What `work` raised; other errors come as `TaskError`.
    """
    instance("chunks", chunks, Chunks)
    instance("shard", shard, Shard, optional=True)
    optional_callable("progress", progress)
    optional_callable("prepare", prepare)
    jobs = checked_jobs(jobs)
    if shard is not None and scheduler is not None:
        raise InvalidValue("shard", f"{shard.number}/{shard.count}", "needs no scheduler; choose one of both")
    place = ChunkFolder(folder)
    place.open(chunks, specification, where)
    mine = [index for index in range(len(chunks)) if shard is None or shard.has(index)]
    done = {index for index in place.done().intersection(mine) if place.sound(index)}
    rest = [index for index in mine if index not in done]
    total = sum(len(chunks.rows_of(index)) for index in mine)
    finished = total - sum(len(chunks.rows_of(index)) for index in rest)
    if progress is not None:
        progress(finished, total)
    # The workers may have another working directory.
    job = _Job(work, chunks, ChunkFolder(place.path.absolute()), place.hash, lost)
    for index in _computed_chunks(job, rest, jobs, scheduler, shard, allowed_failures, prepare):
        finished += len(chunks.rows_of(index))
        if progress is not None:
            progress(finished, total)
    return place


def checked_jobs(jobs: int | None) -> int:
    """The number of workers that is asked for; by default one a core."""
    jobs = usable_cores() if jobs is None else whole("jobs", jobs, 1)
    if jobs > MOST_JOBS:
        raise InvalidValue("jobs", jobs, f"must not exceed {MOST_JOBS}")
    return jobs


@dataclass(frozen=True)
class _Job:
    """What is computed, and where it goes."""

    work: Work
    chunks: Chunks
    folder: ChunkFolder
    run: str
    lost: Lost | None


def _computed_chunks(
    job: _Job,
    rest: list[int],
    jobs: int,
    scheduler: str | None,
    shard: Shard | None,
    allowed_failures: int,
    prepare: Callable[[], None] | None,
) -> Iterator[int]:
    """The chunks, each when it is written."""
    if not rest:
        return
    prepare = prepare or (lambda: None)
    if scheduler is None and (shard is not None or jobs == 1):
        prepare()
        for index in rest:
            stored(job.work, job.chunks.rows_of(index), job.folder.file(index), job.run)
            yield index
        return
    cluster: AbstractContextManager[Cluster] = (
        embedded(min(jobs, len(rest)), allowed_failures, _module(job.work))
        if scheduler is None
        else connected(scheduler)
    )
    with cluster as opened:
        prepare()
        yield from _over(opened, job, rest)


def _over(cluster: Cluster, job: _Job, rest: list[int]) -> Iterator[int]:
    """The chunks over a cluster; those whose workers died are looked into when all others are done."""
    import cloudpickle

    packed: bytes = cloudpickle.dumps(job.work)
    suspects: list[int] = []

    def chunk(index: int) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return sent, (stored, packed, job.chunks.rows_of(index), job.folder.file(index), job.run)

    for index, result in spread(cluster, rest, chunk):
        if isinstance(result, Killed):
            suspects.append(index)
            continue
        _check_there(job.folder.file(index))
        yield index
    for index in suspects:
        rows = job.chunks.rows_of(index)
        save_table(job.folder.file(index), halved(cluster, packed, rows, job.lost), rows, job.run)
        yield index


def _module(work: Work) -> str:
    """Of the work's own function or class, for workers to import while they start; empty: only here."""
    name = str(getattr(work, "__module__", ""))
    return "" if name == "__main__" else name


def _check_there(path: Path) -> None:
    """Raise `ResultError` where a worker wrote to a file system that is not this one's."""
    if not path.exists():
        raise ResultError(
            path, "was written by a worker but is not here: workers must see the folder under the same path"
        )
