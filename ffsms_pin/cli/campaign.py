"""`ffsms-pin campaign` and `ffsms-pin merge`: one scenario many times, its table, report and figures."""

from __future__ import annotations

import argparse
from pathlib import Path

from rich.table import Table

import ffsms_pin.campaigns as campaigns
from ffsms_pin.campaigns.report import report_numbers
from ffsms_pin.cli.arguments import work_arguments
from ffsms_pin.cli.output import NO_FIGURES, new_table, output_console, say
from ffsms_pin.cli.progress import counted_progress
from ffsms_pin.cli.results_folder import chosen_folder, write_numbers
from ffsms_pin.errors import ResultError
from ffsms_pin.extras import installed

__all__ = ["run", "run_merge"]

_SHOWN = 5  # of the worst runs


def run(arguments: argparse.Namespace) -> int:
    """Run the campaign, and where it is complete, make table, report and figures."""
    work = work_arguments(arguments)
    chosen = campaigns.Campaign.read(
        arguments.scenario, arguments.runs, arguments.seed, allow_import=arguments.allow_import
    )
    folder = chosen_folder(arguments.out, f"{chosen.source.stem}-campaign")
    with counted_progress("runs") as progress:
        place = campaigns.campaign(chosen, folder, progress=progress, **work)
    if arguments.shard is None:
        _merged(folder)
    else:
        missing = len(place.missing())
        words = f"{missing} chunks are missing still" if missing else "all shards are done"
        say(f"shard {arguments.shard} is done; {words}; the table: ffsms-pin merge {folder}")
    return 0


def run_merge(arguments: argparse.Namespace) -> int:
    """Make the table, and print the report."""
    folder = Path(arguments.folder)
    if not folder.is_dir():
        raise ResultError(folder, "is not the folder of a campaign; make one with `ffsms-pin campaign`")
    _merged(folder, arguments.partial)
    return 0


def _merged(folder: Path, partial: bool = False) -> None:
    """Merge a campaign, write its report and figures into its folder, and print the report."""
    campaigns.merge(folder, partial=partial)
    found = campaigns.report(folder)
    write_numbers(folder / "report.json", report_numbers(found))
    if installed("plot"):
        from ffsms_pin.plotting import save_formats
        from ffsms_pin.plotting.comparisons import plot_campaign

        save_formats(plot_campaign(found), folder / "report")
    else:
        say(NO_FIGURES)
    output_console().print(_table(found, folder.name))
    for row in found.worst[:_SHOWN]:
        error = row["final_error_m"]
        end = "" if error is None else f", {1e3 * error:.3g} mm from the target"
        why = f": {row['error']}" if row["error"] else ""
        say(f"seed {row['seed']}: {row['outcome']}{end}{why}")
    say(f"one of them alone: ffsms-pin run --replay {folder} SEED", f"results: {folder}")


def _table(found: campaigns.Report, name: str) -> Table:
    low, high = (100.0 * share for share in found.interval)
    table = new_table(f"{name}: {found.runs} runs", "quantity", "5 %", "median", "95 %", "99 %")
    for label, key, factor in (
        ("final error \\[mm]", "final_error_m", 1e3),
        ("largest joint error \\[mrad]", "joint_error_max_rad", 1e3),
        ("largest torque \\[Nm]", "torque_max", 1.0),
        ("largest turn of the base \\[deg]", "base_rotation_max_deg", 1.0),
    ):
        if key in found.percentiles:
            values = found.percentiles[key]
            table.add_row(label, *(f"{factor * values[percent]:.3g}" for percent in (5, 50, 95, 99)))
    others = ", ".join(f"{count} {name}" for name, count in found.outcomes.items() if count)
    table.caption = (
        f"{100.0 * found.success:.4g} % arrived (95 % interval {low:.4g} to {high:.4g} %): {others}"
    )
    table.caption_justify = "left"
    return table
