"""`run` and `collected`: rows of work into a folder of chunk files, or into memory."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

from ffsms_pin.checks import instance, optional_callable
from ffsms_pin.engine.chunks import ChunkFolder, Chunks, Shard, Table, Work, computed, joined, save_chunk
from ffsms_pin.engine.cluster import ALLOWED_FAILURES, Cluster, checked_jobs, connected, embedded
from ffsms_pin.engine.spread import KILLED, spread
from ffsms_pin.errors import InvalidValue, ResultError, TaskError

# The table that stands for a row (its number, what happened) that kills its worker.
Lost: TypeAlias = Callable[[int, str], Table]


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
    rest = [chunks.rows_of(index) for index in mine if index not in done]
    total = sum(len(chunks.rows_of(index)) for index in mine)
    finished = total - sum(map(len, rest))
    progress = progress or (lambda done, total: None)
    progress(finished, total)
    if not rest:
        return place
    workers: AbstractContextManager[Cluster | None] = nullcontext()
    if scheduler is not None:
        workers = connected(scheduler)
    elif shard is None and jobs > 1:
        # The module of the work's own function or class, for workers to import while they start.
        module = str(getattr(work, "__module__", "")).removeprefix("__main__")
        workers = embedded(min(jobs, len(rest)), allowed_failures, module)
    there = ChunkFolder(place.path.absolute())  # workers may have another working directory
    fill = _Filling(work, chunks, there, place.hash)
    with workers as cluster:
        if prepare is not None:
            prepare()
        here = ([(rows, fill(rows))] for rows in rest)
        for parts in here if cluster is None else spread(cluster, fill, rest):
            finished += fill.finish(parts, lost)
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


@dataclass(frozen=True)
class _Filling:
    """What a worker does of a run: it computes some rows, and writes those that are a chunk to its file."""

    work: Work
    chunks: Chunks
    folder: ChunkFolder
    run: str

    def __call__(self, rows: range) -> Table | None:
        """The table of rows that are a part of a chunk, or None: it is written."""
        table, index = computed(self.work, rows), rows.start // self.chunks.size
        if rows != self.chunks.rows_of(index):
            return table
        save_chunk(self.folder.file(index), table, rows, self.run)
        return None

    def finish(self, parts: Sequence[tuple[range, Any]], lost: Lost | None) -> int:
        """See to it that the file is there of a chunk that came in parts; the number of its rows."""
        tables = [self._lost(rows, lost) if table is KILLED else table for rows, table in parts]
        index = parts[0][0].start // self.chunks.size
        file, rows = self.folder.file(index), self.chunks.rows_of(index)
        if tables[0] is not None:
            save_chunk(file, joined(tables), rows, self.run)
        elif not file.exists():
            words = "was written by a worker but is not here: workers must see the folder under the same path"
            raise ResultError(file, words)
        return len(rows)

    def _lost(self, rows: range, lost: Lost | None) -> Table:
        """The table of a row that kills its worker; `TaskError` where there is nothing to stand for it."""
        if lost is None:
            raise TaskError(f"row {rows.start} {KILLED} (out of memory, or a crash in compiled code)")
        table = lost(rows.start, KILLED)
        return computed(lambda _: table, rows)
