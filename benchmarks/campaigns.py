"""What campaigns cost: whole commands, chunks, a large table. `python benchmarks/campaigns.py [RUNS ...]`."""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from pyarrow import parquet
from table import markdown
from timing import command

from ffsms_pin.campaigns import Campaign, merge, runs_file
from ffsms_pin.campaigns.single import table_of
from ffsms_pin.engine import Chunks, run

SCENARIO = Path(__file__).with_name("ten_thousand.toml")
CHUNKS = 500  # of one row each
MANY = 1_000_000  # rows of the large table


def whole(runs: int, jobs: int, folder: Path) -> tuple[str, ...]:
    """One row: a whole command."""
    words = ["campaign", str(SCENARIO), "--runs", str(runs), "--jobs", str(jobs)]
    cost = command([*words, "--out", str(folder / f"{runs}-{jobs}")])
    found = parquet.read_table(runs_file(folder / f"{runs}-{jobs}"))["outcome"].to_pylist()
    arrived = f"{found.count('arrived')} of {runs}"
    return f"{runs}", f"{jobs}", arrived, f"{cost.used:.0f} s", f"{cost.clock:.0f} s", f"{cost.memory:.0f} MB"


def chunk(folder: Path) -> float:
    """Processor time [s] of the process with the scheduler, a chunk."""

    def nothing(rows: range) -> dict[str, np.ndarray]:
        return {"x": np.zeros(len(rows))}

    spent = []
    for chunks in (1, 1 + CHUNKS):
        begun = time.process_time()
        run(nothing, Chunks(chunks, 1), folder / f"chunks-{chunks}", specification={}, jobs=2)
        spent.append(time.process_time() - begun)
    return (spent[1] - spent[0]) / CHUNKS


def large(folder: Path) -> tuple[float, float, float]:
    """A million rows of a campaign: merged [s], as a file [MB], and the slowest column read [s]."""
    rng, chosen = np.random.default_rng(1), Campaign.read(SCENARIO, MANY)

    def table(rows: range) -> dict[str, np.ndarray]:
        small = table_of(chosen, [(0, {"outcome": "arrived"})])
        columns = {name: np.repeat(column, len(rows)) for name, column in small.items()}
        columns |= {"run": np.array(rows), "seed": np.array(rows) + 1}
        drawn = {name: rng.normal(size=len(rows)) for name in columns if columns[name].dtype.kind == "f"}
        return columns | drawn

    run(table, Chunks(MANY, 10_000), folder, specification={}, jobs=1)
    begun = time.process_time()
    merge(folder)
    merged, slowest = time.process_time() - begun, 0.0
    for name in parquet.read_schema(runs_file(folder)).names:
        begun = time.process_time()
        parquet.read_table(runs_file(folder), columns=[name])[name].to_pandas()
        slowest = max(slowest, time.process_time() - begun)
    return merged, runs_file(folder).stat().st_size / 1e6, slowest


if __name__ == "__main__":
    counts = [int(word) for word in sys.argv[1:]] or [200, 600]
    with tempfile.TemporaryDirectory() as name:
        rows = [whole(runs, jobs, Path(name)) for runs in counts for jobs in (1, 2)]
        one, (merged, size, slowest) = chunk(Path(name)), large(Path(name) / "large")
    head = ("runs", "processes", "arrived", "processor time", "by the clock", "memory of the first process")
    print(markdown(head, rows))
    costs = (
        ("a chunk, in the process with the scheduler", f"{1e3 * one:.1f} ms"),
        (f"a table of {MANY} rows", f"merged in {merged:.1f} s, {size:.0f} MB"),
        ("its slowest column", f"read in {slowest:.2f} s"),
    )
    print(f"\n{markdown(('what', 'processor time'), costs)}")
