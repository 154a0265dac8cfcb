"""What a campaign comes to: its table, success rate, percentiles, and the worst runs with their seeds.

`merge` makes the table, `report` reads it.
"""

from __future__ import annotations

import math
import os
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.campaigns.single import METRICS, OUTCOMES
from ffsms_pin.checks import FloatArray
from ffsms_pin.engine import ChunkFolder
from ffsms_pin.errors import ResultError
from ffsms_pin.extras import require
from ffsms_pin.files import check_readable, write_atomically
from ffsms_pin.studies.numbers import wilson_interval

_GROUP = 65536  # rows of a row group: large enough to be read fast, small enough for any memory
PERCENTILES = (5, 25, 50, 75, 95, 99)
_WORST = 10  # runs
_ERRORS = 5  # different errors that are told


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

    place, path = ChunkFolder(folder), runs_file(folder)
    chunks, few = place.tables(partial), max(1, _GROUP // place.chunks.size)

    def write(file: IO[bytes]) -> None:
        with ExitStack() as ending:
            writer: Any = None
            while tables := [pa.table(dict(one)) for one in islice(chunks, few)]:
                group = pa.concat_tables(tables).combine_chunks()
                writer = writer or ending.enter_context(parquet.ParquetWriter(file, group.schema))
                writer.write_table(group)

    write_atomically(path, write)
    return path


@dataclass(frozen=True, eq=False)
class Report:
    """A campaign's table in numbers.

    Attributes
    ----------
    runs : int
    outcomes : dict of str to int
        Number of runs by outcome.
    success : float
        Share of the runs that arrived.
    interval : tuple of float
        95 % confidence interval of it, Wilson's.
    percentiles : dict of str to dict of int to float
        By metric; of the runs that have it.
    worst : list of dict
        Runs that ended worst: those without an end first, then by their final error. Keys: run, seed,
        outcome, error, final_error_m.
    errors : dict of str to int
        The most frequent errors, and how often each occurred.
    final_errors : ndarray, shape (runs,)
        [m], NaN where a run has none.
    outcome : ndarray of str, shape (runs,)
    draws : dict of str to ndarray, shape (runs,)
        Drawn numbers by key.
    """

    runs: int
    outcomes: dict[str, int]
    success: float
    interval: tuple[float, float]
    percentiles: dict[str, dict[int, float]]
    worst: list[dict[str, Any]]
    errors: dict[str, int]
    final_errors: FloatArray
    outcome: NDArray[np.str_]
    draws: dict[str, FloatArray]


def report(folder: str | os.PathLike[str]) -> Report:
    """The report of a campaign that `merge` made one table of.

    Raises
    ------
    ResultError
        There is no table, or it is damaged.
    DependencyMissing
        pyarrow, or what else comes with ffsms-pin[cluster], is not installed.
    """
    table = _read(folder)
    outcome = np.array(table["outcome"], dtype=np.str_)
    final = table["final_error_m"]
    runs, arrived = len(outcome), int((outcome == OUTCOMES[0]).sum())
    # A run that has no end, or not the end it should have, is worse than any that arrived or missed.
    unfinished = ~np.isin(outcome, OUTCOMES[:2])
    order = np.lexsort((table["run"], -np.nan_to_num(final, nan=np.inf), ~unfinished))[:_WORST]
    keys = ("run", "seed", "outcome", "error", "final_error_m")
    texts, counts = np.unique(np.array([text for text in table["error"] if text]), return_counts=True)
    most = np.argsort(-counts, kind="stable")[:_ERRORS]
    return Report(
        runs,
        {name: int((outcome == name).sum()) for name in OUTCOMES},
        arrived / runs,
        wilson_interval(arrived, runs),
        {name: found for name in METRICS if (found := _percentiles(table[name]))},
        [{key: _plain(table[key][i]) for key in keys} for i in order],
        {str(texts[i]): int(counts[i]) for i in most},
        final,
        outcome,
        {
            name.removeprefix("draw."): np.asarray(column)
            for name, column in table.items()
            if name.startswith("draw.") and np.asarray(column).dtype.kind == "f"
        },
    )


def report_numbers(found: Report) -> dict[str, Any]:
    """A report as JSON can hold it."""
    return {
        "runs": found.runs,
        "outcomes": found.outcomes,
        "success_rate": found.success,
        "success_rate_95_percent": list(found.interval),
        "percentiles": found.percentiles,
        "worst": found.worst,
        "errors": found.errors,
    }


def _read(folder: str | os.PathLike[str]) -> dict[str, Any]:
    """The columns of the table: numbers as arrays, text as lists."""
    require("cluster", "a campaign's table")
    from pyarrow import ArrowException, parquet

    path = runs_file(folder)
    try:
        check_readable(path, math.inf)  # a campaign may have any number of runs
        table = parquet.read_table(path)
        return {name: table[name].to_numpy() for name in table.column_names}
    except FileNotFoundError:
        raise ResultError(path, "there is no such file; make it with: ffsms-pin merge") from None
    except (OSError, ArrowException):
        raise ResultError(path, "cannot be read as a table of runs") from None


def _percentiles(column: FloatArray) -> dict[int, float]:
    """Percentiles of the finite values; empty where there is none."""
    finite = column[np.isfinite(column)]
    found = np.percentile(finite, PERCENTILES).tolist() if finite.size else []
    return dict(zip(PERCENTILES, found, strict=False))


def _plain(value: Any) -> Any:
    """A number or text for JSON; None for NaN."""
    plain = value.item() if isinstance(value, np.generic) else value
    return None if isinstance(plain, float) and not math.isfinite(plain) else plain
