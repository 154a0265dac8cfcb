"""`campaign`: many runs of one scenario into a folder; `replayed_scenario`: one of them again."""

from __future__ import annotations

import os
from collections.abc import Callable

from ffsms_pin.campaigns.definition import Campaign
from ffsms_pin.campaigns.single import CampaignRuns
from ffsms_pin.checks import instance, whole
from ffsms_pin.engine import ChunkFolder, Chunks, Shard, run
from ffsms_pin.engine.cluster import ALLOWED_FAILURES
from ffsms_pin.errors import InvalidValue, ResultError
from ffsms_pin.extras import require
from ffsms_pin.scenarios import Scenario

__all__ = ["campaign", "campaign_of", "replayed_scenario"]


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
