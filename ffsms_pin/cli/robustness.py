"""`ffsms-pin robustness`: a scenario on many plants that are not its model."""

from __future__ import annotations

import argparse
import shutil
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ffsms_pin.cli.output import output_console, say
from ffsms_pin.cli.progress import shown_progress
from ffsms_pin.cli.results_folder import chosen_folder, results_folder, write_results
from ffsms_pin.engine import parts_folder
from ffsms_pin.plotting.comparisons import plot_robustness
from ffsms_pin.scenarios import robustness, scenario
from ffsms_pin.scenarios.robustness import robustness_numbers

__all__ = ["run"]


def run(arguments: argparse.Namespace) -> int:
    """Simulate, print the table and write the results."""
    chosen = scenario(arguments.scenario, allow_import=arguments.allow_import)
    folder = chosen_folder(arguments.out, f"{chosen.name}-robustness")
    parts = parts_folder(folder)
    with results_folder(folder) as staging, shown_progress(Console(stderr=True)) as progress:
        found = robustness(
            chosen,
            arguments.plants,
            arguments.seed,
            arm_mass=arguments.arm_mass,
            base_mass=arguments.base_mass,
            base_inertia=arguments.base_inertia,
            jobs=arguments.jobs,
            folder=parts,
            progress=progress,
        )
        numbers = robustness_numbers(found)
        write_results(staging / "robustness", numbers, plot_robustness(found))
    shutil.rmtree(parts, ignore_errors=True)
    output_console().print(_table(numbers))
    say(f"results: {folder}")
    return 0


def _table(numbers: dict[str, Any]) -> Table:
    table = Table(
        title=escape(f"{numbers['scenario']}: {numbers['plants']} random plants"), title_justify="left"
    )
    table.add_column("quantity")
    methods = numbers["methods"]
    for method in methods:
        table.add_column(method, justify="right")
    reach = f"{1e3 * numbers['reach_m']:g}"
    table.add_row(
        f"within {reach} mm at the end",
        *(f"{row['arrived']} of {numbers['plants']}" for row in methods.values()),
    )
    table.add_row(
        "share of all plants, 95 % interval \\[%]",
        *(_percent(row["arrived_95_percent_interval"]) for row in methods.values()),
    )
    if any(row["stopped"] for row in methods.values()):
        table.add_row("stopped on the way", *(str(row["stopped"]) for row in methods.values()))
    for label, key in (
        ("final error, median", "final_error_median_m"),
        ("final error, 95 % of the plants", "final_error_95_percent_m"),
        ("final error, worst", "final_error_worst_m"),
    ):
        table.add_row(
            f"{label} \\[mm]",
            *("-" if row[key] is None else f"{1e3 * row[key]:.3g}" for row in methods.values()),
        )
    return table


def _percent(shares: list[float]) -> str:
    low, high = shares
    return f"{100.0 * low:.1f} to {100.0 * high:.1f}"
