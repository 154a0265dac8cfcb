"""`merge`: the chunks of a campaign as one Parquet file."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from ffsms_pin.engine import ChunkFolder
from ffsms_pin.errors import DependencyMissing
from ffsms_pin.storage import write_atomically

__all__ = ["merge", "runs_file"]

_GROUP = 65536  # rows of a row group: large enough to be read fast, small enough for any memory


def runs_file(folder: str | os.PathLike[str]) -> Path:
    """Where the table of a campaign is."""
    return ChunkFolder(folder).path / "runs.parquet"


def merge(folder: str | os.PathLike[str], *, partial: bool = False) -> Path:
    """Make one Parquet file of a campaign's chunks, one row a run, in their order.

    Its memory does not depend on the number of runs. The chunks stay.

    Parameters
    ----------
    folder : path
    partial : bool
        Whether to take the runs that are done where others are missing.

    Returns
    -------
    Path
        The file, DIR/runs.parquet.

    Raises
    ------
    ResultError
        Runs are missing, a chunk is damaged, or the file cannot be written.
    DependencyMissing
        pyarrow is not installed.
    """
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        raise DependencyMissing("pyarrow", "a campaign's table", "cluster") from None
    groups = _groups(ChunkFolder(folder), partial, pa)
    path = runs_file(folder)

    def write(file: IO[bytes]) -> None:
        writer: Any = None
        try:
            for group in groups:
                if writer is None:
                    writer = parquet.ParquetWriter(file, group.schema)
                writer.write_table(group)
        finally:
            if writer is not None:
                writer.close()

    write_atomically(path, write)
    return path


def _groups(place: ChunkFolder, partial: bool, pa: Any) -> Iterator[Any]:
    """Arrow tables of many chunks each."""
    waiting: list[Any] = []
    for table in place.tables(partial):
        waiting.append(pa.table({name: pa.array(column) for name, column in table.items()}))
        if sum(len(one) for one in waiting) >= _GROUP:
            yield pa.concat_tables(waiting).combine_chunks()
            waiting = []
    if waiting:
        yield pa.concat_tables(waiting).combine_chunks()
