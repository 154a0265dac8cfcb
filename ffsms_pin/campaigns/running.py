"""`campaign`: many runs of one scenario into a folder; `replayed_scenario`: one of them again.

`merge` makes one table of the folder.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any

from ffsms_pin.campaigns.definition import Campaign
from ffsms_pin.campaigns.single import CampaignRuns
from ffsms_pin.checks import instance, whole
from ffsms_pin.engine import ChunkFolder, Chunks, Shard, run
from ffsms_pin.engine.cluster import ALLOWED_FAILURES
from ffsms_pin.errors import InvalidValue, ResultError
from ffsms_pin.extras import require
from ffsms_pin.scenarios import Scenario
from ffsms_pin.storage import write_atomically

_GROUP = 65536  # rows of a row group: large enough to be read fast, small enough for any memory


def campaign(
    of: Campaign,
    folder: str | os.PathLike[str],
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    shard: Shard | None = None,
    progress: Callable[[int, int], None] | None = None,
    allowed_failures: int = ALLOWED_FAILURES,
) -> ChunkFolder:
    """Run a campaign, or go on with one that was killed.

    The table does not depend on jobs, scheduler and shards, bit for bit.

    Parameters
    ----------
    of : Campaign
    folder : path
        For the results. `merge` makes one table of it when all runs are done.
    jobs, scheduler, shard, allowed_failures
        As for `ffsms_pin.engine.run`.
    progress : callable, optional
        Called with the number of runs done and of all runs of this call.

    Raises
    ------
    ResultError
        The folder cannot be written, or holds another campaign.
    ClusterError, DependencyMissing
        As for `ffsms_pin.engine.run`. A run that fails is no error: it is a row with its error.
    """
    instance("campaign", of, Campaign)
    require("cluster", "a campaign")
    work = CampaignRuns(of)
    return run(
        work,
        Chunks.fitting(of.runs),
        folder,
        specification=of.specification(),
        where=of.where,
        jobs=jobs,
        scheduler=scheduler,
        shard=shard,
        lost=work.lost,
        progress=progress,
        allowed_failures=allowed_failures,
    )


def campaign_of(folder: str | os.PathLike[str], allow_import: bool = False) -> Campaign:
    """The campaign that a folder was made for; `ResultError`: it holds none."""
    place = ChunkFolder(folder)
    try:
        return Campaign.from_specification(place.specification, place.where, allow_import)
    except (KeyError, TypeError, ValueError):
        raise ResultError(place.path, "holds results, but not of a campaign") from None


def replayed_scenario(folder: str | os.PathLike[str], seed: int, *, allow_import: bool = False) -> Scenario:
    """The scenario of one run of a campaign, to be run alone.

    Parameters
    ----------
    folder : path
        Of the campaign.
    seed : int
        As in the column `seed` of its table.
    allow_import : bool
        As for `ffsms_pin.scenario`.

    Raises
    ------
    ResultError
        The folder holds no campaign.
    InvalidValue
        No run of it has that seed.
    """
    found = campaign_of(folder, allow_import)
    if whole("seed", seed, 0) not in range(found.seed, found.seed + found.runs):
        last = found.seed + found.runs - 1
        raise InvalidValue("seed", seed, f"must be one of the campaign's, {found.seed} to {last}")
    return found.scenario(seed)


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
        As for `report`.
    """
    require("cluster", "a campaign's table")
    import pyarrow as pa
    from pyarrow import parquet

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
