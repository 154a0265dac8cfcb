"""`ffsms-pin compare`: the planning methods side by side."""

from __future__ import annotations

import argparse
import json
from typing import Any

from ffsms_pin.cli.allow_import import add_allow_import
from ffsms_pin.cli.side_by_side import Rows, side_by_side

__all__ = ["add_parser", "run"]

_DESCRIPTION = """\
Plan a scenario by every method, print one table, and write comparison.json and one figure.

example: ffsms-pin compare case-2
"""


def add_parser(subparsers: Any) -> None:
    """Add `compare` to the commands (argparse's subparsers)."""
    parser = subparsers.add_parser(
        "compare",
        help="plan a scenario by every method, side by side",
        description=_DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "scenario", metavar="SCENARIO", help="a packaged one, as case-2, or a scenario file (TOML)"
    )
    parser.add_argument(
        "--methods",
        metavar="METHOD",
        nargs="+",
        help="only these, of horizon, step, paper, resolved-rate, least-disturbance, minimum-effort"
        " (default: all that know what the scenario asks for)",
    )
    parser.add_argument(
        "--out", metavar="DIR", help="folder for the results (default: results/SCENARIO-comparison)"
    )
    add_allow_import(parser)


def run(arguments: argparse.Namespace) -> int:
    """Plan, print the table and write the results; returns the exit code."""
    # Imported only now: --help needs none of it.
    from rich.console import Console

    from ffsms_pin.cli.output import output_console
    from ffsms_pin.cli.progress import shown_progress
    from ffsms_pin.cli.results_folder import chosen_folder, results_folder
    from ffsms_pin.plotting import save_formats
    from ffsms_pin.plotting.comparison import plot_comparison
    from ffsms_pin.scenarios import scenario
    from ffsms_pin.scenarios.compare import compare, comparison_numbers
    from ffsms_pin.storage import write_content

    chosen = scenario(arguments.scenario, allow_import=arguments.allow_import)
    methods = tuple(arguments.methods) if arguments.methods else None
    folder = chosen_folder(arguments.out, f"{chosen.name}-comparison")
    with results_folder(folder) as staging, shown_progress(Console(stderr=True)) as progress:
        comparison = compare(chosen, methods, progress)
        numbers = comparison_numbers(comparison)
        text = json.dumps(numbers, indent=2) + "\n"
        write_content(staging / "comparison.json", text)
        figure = plot_comparison(comparison)
        save_formats(figure, staging / "comparison")
    output = output_console()
    output.print(_table(chosen.name, numbers))
    for method, row in numbers.items():
        if not row["reached"]:
            output.print(
                f"{method} has not reached: {row['note']}", markup=False, highlight=False, soft_wrap=True
            )
    for method, why in comparison.left_out.items():
        output.print(f"left out: {method}, which {why}", markup=False, highlight=False)
    output.print(f"results: {folder}", markup=False, highlight=False, soft_wrap=True)
    return 0


def _table(name: str, numbers: dict[str, dict[str, Any]]) -> Any:
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
    return side_by_side(f"{name}: methods side by side", numbers, rows)
