"""Run a scenario many times, in chunks: `ffsms-pin campaign` and `merge`."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

from rich.table import Table

import ffsms_pin.campaigns as campaigns
from ffsms_pin.campaigns.report import report_numbers
from ffsms_pin.cli import output
from ffsms_pin.cli.main import named, work_arguments
from ffsms_pin.cli.output import chosen_folder, new_table, number_rows, printed, say, write_numbers
from ffsms_pin.errors import ResultError
from ffsms_pin.extras import installed

_SHOWN = 5  # of the worst runs


def campaign(arguments: argparse.Namespace) -> int:
    """Run the campaign, and where it is complete, make table, report and figures."""
    work = work_arguments(arguments)
    how = named(arguments, "runs", "seed", "allow_import")
    chosen = campaigns.Campaign.read(arguments.scenario, **how)
    folder = chosen_folder(arguments.out, f"{chosen.source.stem}-campaign")
    with output.shown_progress() as progress:
        place = campaigns.campaign(chosen, folder, progress=partial(progress, "runs"), **work)
    if arguments.shard is None:
        return _merged(folder)
    missing = len(place.missing())
    words = f"{missing} chunks are missing still" if missing else "all shards are done"
    say(f"shard {arguments.shard} is done; {words}; the table: ffsms-pin merge {folder}")
    return 0


def merge(arguments: argparse.Namespace) -> int:
    """Make the table, and print the report."""
    folder = Path(arguments.folder)
    if not folder.is_dir():
        raise ResultError(folder, "is not the folder of a campaign; make one with `ffsms-pin campaign`")
    return _merged(folder, arguments.partial)


def _merged(folder: Path, partial: bool = False) -> int:
    """Merge a campaign, write its report and figures into its folder, and print the report; the exit code."""
    campaigns.merge(folder, partial=partial)
    found = campaigns.report(folder)
    write_numbers(folder / "report.json", report_numbers(found))
    if installed("plot"):
        from ffsms_pin.plotting import save_formats
        from ffsms_pin.plotting.comparisons import plot_campaign

        save_formats(plot_campaign(found), folder / "report")
    else:
        say(output.NO_FIGURES)
    worst = []
    for row in found.worst[:_SHOWN]:
        error = row["final_error_m"]
        end = "" if error is None else f", {1e3 * error:.3g} mm from the target"
        why = f": {row['error']}" if row["error"] else ""
        worst.append(f"seed {row['seed']}: {row['outcome']}{end}{why}")
    alone = f"one of them alone: ffsms-pin run --replay {folder} SEED"
    return printed(folder, _table(found, folder.name), *worst, alone)


def _table(found: campaigns.Report, name: str) -> Table:
    shown = (5, 50, 95, 99)
    table = new_table(f"{name}: {found.runs} runs", "quantity", "5 %", "median", "95 %", "99 %")
    rows = [
        ("final error [mm]", "final_error_m", 1e3),
        ("largest joint error [mrad]", "joint_error_max_rad", 1e3),
        ("largest torque [Nm]", "torque_max", 1.0),
        ("largest turn of the base [deg]", "base_rotation_max_deg", 1.0),
    ]
    number_rows(table, ({key: row[i] for key, row in found.percentiles.items()} for i in shown), rows)
    low, high = (100.0 * share for share in found.interval)
    others = ", ".join(f"{count} {name}" for name, count in found.outcomes.items() if count)
    table.caption = (
        f"{100.0 * found.success:.4g} % arrived (95 % interval {low:.4g} to {high:.4g} %): {others}"
    )
    table.caption_justify = "left"
    return table
