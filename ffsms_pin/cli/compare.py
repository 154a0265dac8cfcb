"""The command `ffsms-pin compare`: the plans of a scenario by every method."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

from ffsms_pin import scenarios
from ffsms_pin.analysis import plan_numbers, why_not_reached
from ffsms_pin.cli.output import (
    chosen_folder,
    new_table,
    number_rows,
    printed,
    results_folder,
    shown_progress,
    write_numbers,
)
from ffsms_pin.plotting import save_formats
from ffsms_pin.plotting.comparisons import plot_comparison
from ffsms_pin.scenarios.fits import OF_HORIZON

_ROWS = [
    ("final error [mm]", "final_error_m", 1e3),
    ("largest error on the path [mm]", "path_error_max_m", 1e3),
    ("cost integral [s]", "cost_integral_s", 1.0),
    ("joint travel [rad]", "joint_travel_rad", 1.0),
    ("path length / straight line", "path_over_straight", 1.0),
    ("joint effort [rad²/s]", "joint_effort_rad2_per_s", 1.0),
    ("torque effort [N²m²s]", "torque_effort_N2m2s", 1.0),
    ("base rotation, max [deg]", "rotation_max_deg", 1.0),
    ("base translation, max [mm]", "translation_max_m", 1e3),
    ("peak joint rate [rad/s]", "peak_rate_rad_per_s", 1.0),
    ("computing time [s]", "planning_s", 1.0),
]


def run(arguments: argparse.Namespace) -> int:
    """Plan by each method, write the numbers and the figure, and print the table."""
    chosen = scenarios.scenario(arguments.scenario, allow_import=arguments.allow_import)
    methods = tuple(arguments.methods) if arguments.methods else None
    folder = chosen_folder(arguments.out, f"{chosen.name}-comparison")
    with results_folder(folder) as staging, shown_progress() as progress:
        comparison = scenarios.compare(chosen, methods, progress)
        numbers = comparison_numbers(comparison)
        write_numbers(staging / "comparison.json", numbers)
        save_formats(plot_comparison(comparison), staging / "comparison")
    table = new_table(f"{chosen.name}: methods side by side", "quantity", *numbers)
    table.add_row("reached", *("yes" if row["reached"] else "no" for row in numbers.values()))
    number_rows(table, numbers.values(), _ROWS)
    return printed(folder, table, *_remarks(comparison, numbers))


def comparison_numbers(comparison: scenarios.Comparison) -> dict[str, dict[str, Any]]:
    """Return a row for each method: `plan_numbers`, planning time [s], and the note or reason of a miss."""
    return {
        method: {
            **plan_numbers(comparison.sms, made),
            "planning_s": comparison.times[method],
            "note": why_not_reached(made) or made.note,
        }
        for method, made in comparison.plans.items()
    }


def _remarks(comparison: scenarios.Comparison, numbers: dict[str, dict[str, Any]]) -> Iterator[str]:
    """Yield lines about missed targets, omitted methods, and keys of [plan] that only one method uses."""
    for name, row in numbers.items():
        if not row["reached"]:
            yield f"{name} does not reach the target: {row['note']}"
    for name, reason in comparison.left_out.items():
        yield f"left out: {name}, which {reason}"
    if options := [key for key in OF_HORIZON if key in comparison.scenario.plan]:
        yield f"only the method horizon uses {', '.join(options)} of [plan]"
