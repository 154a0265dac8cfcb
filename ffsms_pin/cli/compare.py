"""`ffsms-pin compare`: the planning methods side by side."""

from __future__ import annotations

import argparse

from rich.console import Console

from ffsms_pin.cli.output import Rows, output_console, say, side_by_side
from ffsms_pin.cli.progress import shown_progress
from ffsms_pin.cli.results_folder import chosen_folder, results_folder, write_results
from ffsms_pin.plotting.comparisons import plot_comparison
from ffsms_pin.scenarios import scenario
from ffsms_pin.scenarios.compare import compare, comparison_numbers

__all__ = ["run"]


def run(arguments: argparse.Namespace) -> int:
    """Plan, print the table and write the results."""
    chosen = scenario(arguments.scenario, allow_import=arguments.allow_import)
    methods = tuple(arguments.methods) if arguments.methods else None
    folder = chosen_folder(arguments.out, f"{chosen.name}-comparison")
    with results_folder(folder) as staging, shown_progress(Console(stderr=True)) as progress:
        comparison = compare(chosen, methods, progress)
        numbers = comparison_numbers(comparison)
        write_results(staging / "comparison", numbers, plot_comparison(comparison))
    rows: Rows = {
        "reached": lambda row: "yes" if row["reached"] else "no",
        "final error [mm]": lambda row: f"{1e3 * row['final_error_m']:.3g}",
        "cost integral [s]": lambda row: f"{row['cost_integral_s']:.3g}",
        "joint travel [rad]": lambda row: f"{row['joint_travel_rad']:.3g}",
        "path over straight line": lambda row: f"{row['path_over_straight']:.3g}",
        "joint effort [rad²/s]": lambda row: f"{row['joint_effort_rad2_per_s']:.3g}",
        "torque effort [N²m²s]": lambda row: f"{row['torque_effort_N2m2s']:.3g}",
        "base rotation, max [deg]": lambda row: f"{row['rotation_max_deg']:.3g}",
        "base translation, max [mm]": lambda row: f"{1e3 * row['translation_max_m']:.3g}",
        "peak joint rate [rad/s]": lambda row: f"{row['peak_rate_rad_per_s']:.3g}",
        "computing time [s]": lambda row: f"{row['planning_s']:.2f}",
    }
    output_console().print(side_by_side(f"{chosen.name}: methods side by side", numbers, rows))
    say(
        *(
            f"{method} has not reached: {row['note']}"
            for method, row in numbers.items()
            if not row["reached"]
        ),
        *(f"left out: {method}, which {why}" for method, why in comparison.left_out.items()),
        f"results: {folder}",
    )
    return 0
