"""The runs of a campaign, in this process or on Dask, with one file for each chunk of seeds."""

from __future__ import annotations

import asyncio
import csv
import io
import json
import logging
import os
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import ExitStack
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from ffsms_pin.campaigns.definition import Campaign
from ffsms_pin.campaigns.draws import drawn_columns
from ffsms_pin.campaigns.rows import run_numbers
from ffsms_pin.checks import whole
from ffsms_pin.errors import ClusterError, InvalidValue, ResultError, installed, require
from ffsms_pin.files import LARGEST_DATA, path_like, read_content, wrap_os_error, write_content
from ffsms_pin.processes import usable_cores

_LOCAL: Any = {"threads_per_worker": 1, "host": "127.0.0.1", "dashboard_address": "127.0.0.1:0"}
_LOCAL |= {"scheduler_kwargs": {"dashboard": False}, "silence_logs": logging.CRITICAL}


def campaign(
    of: Campaign,
    folder: str | os.PathLike[str],
    *,
    jobs: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Run the missing seeds of a campaign in a folder, write the table of all runs, and return its path.

    `jobs` is the number of processes; 1 means this process. The default is the number of usable cores, or 1
    without Dask. `scheduler` is the address of a Dask scheduler, such as "tcp://host:8786", whose workers
    need the folder under the same path. `progress` is called with the numbers of completed and of all runs.
    """
    if scheduler is not None and jobs is not None:
        raise InvalidValue("jobs", jobs, "must be left out, because the scheduler's workers do the runs")
    jobs = (usable_cores() if installed("cluster") else 1) if jobs is None else whole("jobs", jobs, 1, 1024)
    if not (alone := scheduler is None and jobs == 1):
        require("cluster", "a campaign in several processes")
    of, place = replace(of, hash=of.digest()), path_like("folder", folder).absolute()
    with wrap_os_error(place):
        (place / "chunks").mkdir(parents=True, exist_ok=True)
    write_content(place / "campaign.json", json.dumps(vars(of), indent=1) + "\n")
    missing = [seeds for seeds in _chunks(of) if _read(of, place, seeds) is None]
    done, here = of.runs - sum(map(len, missing)), (_run(of, place, seeds) for seeds in missing)
    for seeds in chain([()], here if alone or not missing else _on_dask(of, place, missing, jobs, scheduler)):
        done += len(seeds)
        if progress is not None:
            progress(done, of.runs)
    table = read_table(place)
    lines = zip(*(column.tolist() for column in table.values()), strict=True)
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([table, *lines])
    write_content(place / "runs.csv", text.getvalue())
    return place / "runs.csv"


def read_table(folder: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the table of the runs in a folder: columns by name, in the order of the seeds."""
    of = Campaign.open(folder)
    rows = [row for seeds in _chunks(of) for row in _read(of, Path(folder), seeds) or ()]
    if not rows:
        raise ResultError(folder, "holds no runs; make them with ffsms_pin.campaigns.campaign")
    table = {}
    for name in dict.fromkeys(name for row in rows for name in row):
        values = [np.nan if (value := row.get(name)) is None else value for row in rows]
        table[name] = np.array(values, object if any(isinstance(value, str) for value in values) else None)
    return table


def _chunks(of: Campaign) -> list[range]:
    """Return the seeds in chunks of at most 16; each chunk has a file of its own.

    The size of a chunk depends only on the number of seeds before it, so further runs can change only the
    last chunk.
    """
    chunks, start = [], 0
    while start < of.runs:
        end = start + min(max(start // 64, 1), 16)
        chunks.append(of.seeds[start:end])
        start = end
    return chunks


def _run(of: Campaign, folder: Path, seeds: range, rows: list[Any] | None = None) -> range:
    """Write the file of a chunk of seeds, and return the seeds; without `rows`, run the seeds first."""
    rows = [row for seed in seeds for row in _rows(of, seed)] if rows is None else rows
    chunk = {"campaign": of.hash, "seeds": list(seeds), "rows": rows}
    write_content(folder / "chunks" / f"{seeds[0]:010d}.json", json.dumps(chunk) + "\n")
    return seeds


def _read(of: Campaign, folder: Path, seeds: range) -> list[Any] | None:
    """Return the rows of a chunk; None if its file is missing, damaged or made from other inputs."""
    try:
        chunk = json.loads(read_content(folder / "chunks" / f"{seeds[0]:010d}.json", LARGEST_DATA))
        return chunk["rows"] if [chunk["campaign"], chunk["seeds"]] == [of.hash, list(seeds)] else None
    except (OSError, ValueError, LookupError, TypeError):
        return None


def _rows(of: Campaign, seed: int, error: str = "") -> list[Any]:
    """Run a seed and return its rows, one per method.

    With an `error` nothing is run; the rows report that the run killed its process.
    """
    rows = []
    for method in ("planned once", "re-planned") if of.compare else ("",):
        row = {"seed": seed, **({"method": method} if method else {}), **drawn_columns(of.draws, seed)}
        numbers: dict[str, Any] = {"outcome": "killed", "error": error, "final_error_m": None}
        try:
            numbers = numbers if error else run_numbers(of.scenario(seed), method == "planned once", of.hash)
        except Exception as problem:  # after any error the other runs continue
            numbers |= {"outcome": "failed", "error": f"{type(problem).__name__}: {problem}"}
        rows.append(row | numbers)
    return rows


def _on_dask(of: Campaign, folder: Path, missing: list[range], jobs: int, address: Any) -> Iterator[range]:
    """Run chunks on Dask and yield the seeds of each completed chunk."""
    import dask
    from distributed import Client, KilledWorker, LocalCluster, as_completed, comm, utils

    with ExitStack() as stack:
        stack.enter_context(utils.silence_logging_cmgr(logging.CRITICAL))
        try:
            if address is None:
                stack.enter_context(dask.config.set({"distributed.scheduler.allowed-failures": 1}))
                cluster = stack.enter_context(LocalCluster(n_workers=min(jobs, len(missing)), **_LOCAL))
                stack.callback(cluster.sync, _end, cluster)
                address = cluster.scheduler_address
            client = stack.enter_context(Client(address))
            client.wait_for_workers(1, 60.0)
        except (OSError, RuntimeError, ValueError) as problem:
            message = f"the workers of {address or 'Dask'} cannot be {'reached' if address else 'started'}"
            remedy = "" if address else "; in a script, start them under `if __name__ == '__main__':`"
            raise ClusterError(f"{message} ({problem}){remedy}") from None
        try:
            running = {client.submit(_run, of, folder, seeds, pure=False): seeds for seeds in missing}
            suspects: list[range] = []
            for future in as_completed(list(running)):
                seeds = running.pop(future)
                try:
                    yield future.result()
                except KilledWorker:
                    suspects.append(seeds)
            # Dask fails all tasks of a worker that dies, so each seed of these chunks is run alone.
            for seeds in suspects:
                rows: list[Any] = []
                for seed in seeds:
                    try:
                        rows += client.submit(_rows, of, seed, pure=False).result()
                    except KilledWorker as problem:
                        rows += _rows(of, seed, str(problem))
                yield _run(of, folder, seeds, rows)
        except (CancelledError, comm.core.CommClosedError):
            raise ClusterError(
                f"the scheduler at {address} has stopped; run the campaign again to continue"
            ) from None


async def _end(cluster: Any) -> None:
    """Stop the workers first, because a closing cluster waits for unfinished runs, even after Ctrl-C."""
    await asyncio.gather(*(nanny.close(timeout=0.5) for nanny in cluster.workers.values()))
