"""What the command line makes of a campaign that is done: table, report, figures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.table import Table

    from ffsms_pin.campaigns import Report

__all__ = ["told"]

_SHOWN = 5  # of the worst runs


def told(folder: Path, partial: bool = False) -> None:
    """Merge a campaign, write its report and figures into its folder, and print the report."""
    from ffsms_pin.campaigns import merge, report
    from ffsms_pin.campaigns.report import report_numbers
    from ffsms_pin.cli.output import output_console
    from ffsms_pin.extras import installed
    from ffsms_pin.storage import write_content

    merge(folder, partial=partial)
    found = report(folder)
    numbers = json.dumps(report_numbers(found), indent=2, allow_nan=False)
    write_content(folder / "report.json", numbers + "\n")
    output = output_console()
    if installed("plot"):
        from ffsms_pin.plotting import save_formats
        from ffsms_pin.plotting.campaigns import plot_campaign

        save_formats(plot_campaign(found), folder / "report")
    else:
        output.print("no figures: they need matplotlib (pip install 'ffsms-pin[plot]')", markup=False)
    output.print(_table(found, folder.name))
    for row in found.worst[:_SHOWN]:
        error = row["final_error_m"]
        end = "" if error is None else f", {1e3 * error:.3g} mm from the target"
        why = f": {row['error']}" if row["error"] else ""
        words = f"seed {row['seed']}: {row['outcome']}{end}{why}"
        output.print(words, markup=False, highlight=False, soft_wrap=True)
    for words in (
        f"one of them alone: ffsms-pin run --replay {folder} SEED",
        f"results: {folder}",
    ):
        output.print(words, markup=False, highlight=False, soft_wrap=True)


def _table(found: Report, name: str) -> Table:
    from rich.markup import escape
    from rich.table import Table

    low, high = (100.0 * share for share in found.interval)
    table = Table(title=escape(f"{name}: {found.runs} runs"), title_justify="left")
    for column in ("quantity", "5 %", "median", "95 %", "99 %"):
        table.add_column(column, justify="left" if column == "quantity" else "right")
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
