"""Campaigns: CPU time of a run with one and with two workers, and how fast a large table opens.

    python benchmarks/campaigns.py [RUNS]

Times of runs are CPU times, of this process and its workers together, so that other work on the machine does
not count. The efficiency from 1 to 2 workers is that of a machine with two free cores: CPU time a run with
one process, divided by that with two workers, the start of the workers left out.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from pyarrow import parquet

from ffsms_pin.campaigns import Campaign, campaign, merge, runs_file
from ffsms_pin.campaigns.single import table_of
from ffsms_pin.engine import Chunks, run

SCENARIO = """
[robot]
model = "planar_3r"
[start]
joints_deg = [23.0, 40.0, -29.0]
[target]
position = [0.75, 0.5, 0.0]
[control]
law = "sliding-mode"
[sensors]
joint_noise_deg = 0.01
[campaign.draw]
plant.arm_mass = { uniform = [0.8, 1.2] }
plant.base_mass = { normal = [1.0, 0.05] }
"""
TARGETS = "target.position = { uniform = [[0.70, 0.45, 0.0], [0.80, 0.55, 0.0]] }\n"
MANY = 1_000_000  # rows of the large table


def main(runs: int) -> None:
    """Measure, and print."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for title, text in (
            ("one target, one plan", SCENARIO),
            ("a target each, a plan each", SCENARIO + TARGETS),
        ):
            file = folder / "campaign.toml"
            file.write_text(text)
            chosen = Campaign.read(file, runs)
            one = cpu_of(lambda jobs: campaign(chosen, folder / f"{title}-{jobs}", jobs=jobs), 1)  # noqa: B023
            two = cpu_of(lambda jobs: campaign(chosen, folder / f"{title}-{jobs}", jobs=jobs), 2)  # noqa: B023
            start = cpu_of(lambda jobs: idle(folder / f"{title}-start", jobs), 2)  # noqa: B023
            print(f"{title}: {runs} runs")
            print(f"  1 process: {1e3 * one / runs:.0f} ms a run (CPU)")
            print(
                f"  2 workers: {1e3 * (two - start) / runs:.0f} ms a run, and {start:.1f} s for their start"
            )
            print(f"  efficiency {one / (two - start):.2f}; with the start {one / two:.2f}")
        large(chosen, folder / "large")


def cpu_of(work: object, jobs: int) -> float:
    """CPU time [s] of this process and of its workers, which have ended."""

    def spent() -> float:
        times = os.times()
        return times.user + times.system + times.children_user + times.children_system

    before = spent()
    work(jobs)  # type: ignore[operator]
    return spent() - before


def idle(folder: Path, jobs: int) -> None:
    """A run that does nothing but start its workers, and import what the others import."""

    def nothing(rows: range) -> dict[str, np.ndarray]:
        import ffsms_pin.campaigns  # noqa: F401

        return {"x": np.zeros(len(rows))}

    run(nothing, Chunks(jobs, 1), folder, specification={}, jobs=jobs)


def large(chosen: Campaign, folder: Path) -> None:
    """A table of a million rows with the columns of a campaign: merged, and opened column by column."""
    rng = np.random.default_rng(1)

    def table(rows: range) -> dict[str, np.ndarray]:
        small = table_of(chosen, [(0, {"outcome": "arrived"})])
        columns = {name: np.repeat(column, len(rows)) for name, column in small.items()}
        columns["run"] = np.array(rows)
        columns["seed"] = np.array(rows) + 1
        return {
            name: rng.normal(size=len(rows)) if column.dtype.kind == "f" else column
            for name, column in columns.items()
        }

    run(table, Chunks(MANY, 10_000), folder, specification={}, jobs=1)
    begun = time.process_time()
    merge(folder)
    print(f"table of {MANY} rows: merged in {time.process_time() - begun:.1f} s (CPU), ", end="")
    print(f"{runs_file(folder).stat().st_size / 1e6:.0f} MB")
    slowest = 0.0
    for name in parquet.read_schema(runs_file(folder)).names:
        begun = time.process_time()
        parquet.read_table(runs_file(folder), columns=[name])[name].to_pandas()
        slowest = max(slowest, time.process_time() - begun)
    print(f"  slowest column opens in {slowest:.2f} s (CPU)")


if __name__ == "__main__":
    main(int(sys.argv[1]) if sys.argv[1:] else 64)
