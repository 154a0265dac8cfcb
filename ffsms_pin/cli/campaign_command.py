"""`ffsms-pin campaign`: one scenario many times, with what its file draws; `ffsms-pin merge`: its table."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ffsms_pin.cli.allow_import import add_allow_import

__all__ = ["RESUMES", "add_parser", "run"]

RESUMES = True  # the same command goes on where it was stopped

_DESCRIPTION = """\
Run a scenario many times in closed loop, with plants, targets, noise and faults drawn from the distributions
in its table [campaign.draw] (ffsms-pin docs campaigns). Writes one row a run to DIR/runs.parquet, a report
(report.json) and figures. What is killed goes on where it was with the same command, and ends with the same
table, whatever the number of workers and shards.

examples:
  ffsms-pin campaign mine.toml --runs 10000 --out mine          one process a core
  ffsms-pin campaign mine.toml --runs 10000 --out mine --scheduler tcp://head:8786
  ffsms-pin campaign mine.toml --runs 10000 --out mine --shard 3/16     then: ffsms-pin merge mine
  ffsms-pin run --replay mine 4711                              one of its runs alone, by its seed

exit codes: 0 done, however many arrived; 2 bad input, or the run cannot go on; 70 a defect of ffsms-pin;
130 interrupted; 143 terminated
"""


def add_parser(subparsers: Any) -> None:
    """Add `campaign` to the commands (argparse's subparsers)."""
    parser = subparsers.add_parser(
        "campaign",
        help="run a scenario many times with drawn plants, targets, noise and faults",
        description=_DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("scenario", metavar="FILE", help="a scenario file (TOML) with [campaign.draw]")
    parser.add_argument("--runs", type=int, metavar="N", required=True, help="how many")
    parser.add_argument("--out", metavar="DIR", help="folder for results (default: results/FILE-campaign)")
    parser.add_argument("--seed", type=int, metavar="N", help="of the first run (default: the file's, or 1)")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--jobs", type=int, metavar="N", help="processes at once (default: one a core)")
    where.add_argument(
        "--scheduler", metavar="ADDRESS", help="of a Dask scheduler that stands, as tcp://host:8786"
    )
    where.add_argument("--shard", metavar="i/N", help="do every N-th chunk from the i-th on, in this process")
    add_allow_import(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the campaign, and where it is complete, make table, report and figures; returns the exit code."""
    from rich.console import Console

    from ffsms_pin.campaigns import Campaign, campaign
    from ffsms_pin.cli.campaign_output import told
    from ffsms_pin.cli.output import output_console
    from ffsms_pin.cli.progress import counted_progress
    from ffsms_pin.cli.results_folder import chosen_folder
    from ffsms_pin.engine import Shard

    shard = None if arguments.shard is None else Shard.read(arguments.shard)
    chosen = Campaign.read(
        arguments.scenario, arguments.runs, arguments.seed, allow_import=arguments.allow_import
    )
    folder = chosen_folder(arguments.out, f"{chosen.source.stem}-campaign")
    with counted_progress(Console(stderr=True), "runs") as progress:
        place = campaign(
            chosen,
            folder,
            jobs=arguments.jobs,
            scheduler=arguments.scheduler,
            shard=shard,
            progress=progress,
        )
    if shard is None:
        told(Path(folder))
    else:
        missing = len(place.missing())
        words = f"{missing} chunks are missing still" if missing else "all shards are done"
        output_console().print(
            f"shard {arguments.shard} is done; {words}; the table: ffsms-pin merge {folder}",
            markup=False,
            highlight=False,
            soft_wrap=True,
        )
    return 0
