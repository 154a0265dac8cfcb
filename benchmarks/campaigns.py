"""Measure the CPU time, wall time and memory of campaigns, and the time to write a large table.

Run from the repository's root: python benchmarks/campaigns.py [RUNS ...]
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from table import markdown
from timing import command

from ffsms_pin.campaigns import Campaign, campaign, read_table, runs

SCENARIO = Path(__file__).with_name("ten_thousand.toml")
MANY = 100_000  # number of runs in the large table


def whole(count: int, jobs: int, folder: Path) -> tuple[str, ...]:
    """Run the command `ffsms-pin campaign`, and return its row of the table."""
    out = folder / f"{count}-{jobs}"
    words = ["campaign", str(SCENARIO), "--runs", str(count), "--jobs", str(jobs), "--out", str(out)]
    cost = command(words)
    arrived = f"{int((read_table(out)['outcome'] == 'arrived').sum())} of {count}"
    return (
        f"{count}",
        f"{jobs}",
        arrived,
        f"{cost.used:.0f} s",
        f"{cost.clock:.0f} s",
        f"{cost.memory:.0f} MB",
    )


def large(folder: Path) -> tuple[float, float, float]:
    """Return the times [s] to write one run and to write the table of `MANY` runs, and its size [MB].

    Stored numbers replace planning and simulation, so that only the campaign itself is timed.
    """
    chosen = Campaign.read(SCENARIO, 1)
    campaign(chosen, folder, jobs=1)
    row: Mapping[str, Any] = {name: column[0] for name, column in read_table(folder).items()}
    numbers = {name: row[name] for name in row if not name.startswith(("seed", "draw."))}
    runs.run_numbers = lambda *_: {name: getattr(x, "tolist", lambda x=x: x)() for name, x in numbers.items()}
    begun = time.process_time()
    path = campaign(replace(chosen, runs=MANY), folder, jobs=1)
    written = time.process_time() - begun
    begun = time.process_time()
    campaign(replace(chosen, runs=MANY), folder, jobs=1)
    return written / MANY, time.process_time() - begun, path.stat().st_size / 1e6


if __name__ == "__main__":
    counts = [int(word) for word in sys.argv[1:]] or [200, 600]
    with tempfile.TemporaryDirectory() as name:
        rows = [whole(count, jobs, Path(name)) for count in counts for jobs in (1, 2)]
        written, read, size = large(Path(name) / "large")
    head = ("runs", "processes", "arrived", "CPU time", "wall time", "memory of the first process")
    print(markdown(head, rows))
    costs = (
        ("a run without planning and simulation", f"{1e3 * written:.2g} ms"),
        (f"the table of {MANY} completed runs", f"{read:.2g} s, {size:.0f} MB"),
    )
    print(f"\n{markdown(('operation', 'CPU time'), costs)}")
