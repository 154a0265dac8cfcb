"""`run` and `collected`: rows of work into a folder of chunk files, or into memory."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ffsms_pin.checks import instance, optional_callable
from ffsms_pin.engine.cluster import ALLOWED_FAILURES, Cluster, checked_jobs, connected, embedded
from ffsms_pin.engine.folder import ChunkFolder
from ffsms_pin.engine.rows import Chunks, Shard, Work, joined, save_table, stored
from ffsms_pin.engine.spread import Lost, chunk_results
from ffsms_pin.errors import InvalidValue, ResultError


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
        Default: such a row ends the run with `TaskError`, and in this process the run itself.
    prepare : callable, optional
        Called in this process before the first chunk that is not there, while the workers start.
    progress : callable, optional
        Called with the number of rows done and of all rows of this call.
    allowed_failures : int
        Deaths of workers after which Dask gives up a task; for the embedded cluster only.

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
    done = place.sound(place.done().intersection(mine))
    rest = [index for index in mine if index not in done]
    total = sum(len(chunks.rows_of(index)) for index in mine)
    finished = total - sum(len(chunks.rows_of(index)) for index in rest)
    progress = progress or (lambda done, total: None)
    progress(finished, total)
    if not rest:
        return place
    there, run = ChunkFolder(place.path.absolute()), place.hash  # workers may have another working directory

    def written(index: int) -> tuple[Path, str]:
        return there.file(index), run

    # Of the work's own function or class, for workers to import while they start; empty: only here.
    module = str(getattr(work, "__module__", "")).removeprefix("__main__")
    workers: AbstractContextManager[Cluster | None] = nullcontext()
    if scheduler is not None:
        workers = connected(scheduler)
    elif shard is None and jobs > 1:
        workers = embedded(min(jobs, len(rest)), allowed_failures, module)
    with workers as cluster:
        if prepare is not None:
            prepare()
        here = _here(work, chunks, rest, written)
        results = here if cluster is None else chunk_results(cluster, work, chunks, rest, written, lost)
        for index, table in results:
            file, rows = there.file(index), chunks.rows_of(index)
            if table is not None:
                save_table(file, table, rows, run)
            elif not file.exists():
                words = (
                    "was written by a worker but is not here: workers must see the folder under the same path"
                )
                raise ResultError(file, words)
            finished += len(rows)
            progress(finished, total)
    return place


def collected(
    work: Work,
    chunks: Chunks,
    *,
    jobs: int | None = None,
    lost: Lost | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """One table of all rows, in their order; no folder is left. Arguments and errors are those of `run`."""
    with TemporaryDirectory(prefix="ffsms-pin-rows-") as folder:
        place = run(work, chunks, folder, specification={}, jobs=jobs, lost=lost, progress=progress)
        return joined(list(place.tables()))


def _here(
    work: Work, chunks: Chunks, indices: Iterable[int], written: Callable[[int], tuple[Path, str]]
) -> Iterator[tuple[int, Any]]:
    """`chunk_results` without a cluster."""
    for index in indices:
        stored(work, chunks.rows_of(index), *written(index))
        yield index, None
