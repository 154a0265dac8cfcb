"""`ffsms-pin compare-modes`: the base held by wheels, and left to float."""

from __future__ import annotations

import argparse
import json
from typing import Any

from ffsms_pin.cli.allow_import import add_allow_import
from ffsms_pin.cli.side_by_side import Rows, side_by_side

__all__ = ["add_parser", "run"]

_DESCRIPTION = """\
Do a scenario's task with the attitude held by its wheels (or thrusters) all the time, and floating: with
coupling used and the base then turned back, with the attitude restored by the arm alone, and straight.
Prints one table, and writes modes.json and one figure. The scenario needs a table [wheels] or [thrusters].

example: ffsms-pin compare-modes mine.toml
"""


def add_parser(subparsers: Any) -> None:
    """Add `compare-modes` to the commands (argparse's subparsers)."""
    parser = subparsers.add_parser(
        "compare-modes",
        help="a task with the base held by wheels, and floating, side by side",
        description=_DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "scenario", metavar="SCENARIO", help="a scenario file (TOML) with wheels or thrusters"
    )
    parser.add_argument(
        "--out", metavar="DIR", help="folder for the results (default: results/SCENARIO-modes)"
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
    from ffsms_pin.plotting.wheels import plot_modes
    from ffsms_pin.scenarios import scenario
    from ffsms_pin.scenarios.modes import compare_modes, mode_numbers
    from ffsms_pin.storage import write_content

    chosen = scenario(arguments.scenario, allow_import=arguments.allow_import)
    folder = chosen_folder(arguments.out, f"{chosen.name}-modes")
    with results_folder(folder) as staging, shown_progress(Console(stderr=True)) as progress:
        comparison = compare_modes(chosen, progress)
        numbers = mode_numbers(comparison.found)
        write_content(staging / "modes.json", json.dumps(numbers, indent=2) + "\n")
        figure = plot_modes(comparison)
        save_formats(figure, staging / "modes")
    output = output_console()
    output.print(_table(chosen.name, numbers, comparison.sms.wheels is None))
    for name, row in numbers.items():
        if not row["reached"]:
            output.print(
                f"{name} has not reached: {row['note']}", markup=False, highlight=False, soft_wrap=True
            )
    output.print(f"results: {folder}", markup=False, highlight=False, soft_wrap=True)
    return 0


def _table(name: str, numbers: dict[str, dict[str, Any]], thrusters_only: bool) -> Any:
    rows: Rows = {
        "reached": lambda row: "yes" if row["reached"] else "no",
        "wheel momentum, max [N m s]": lambda row: f"{row['wheel_momentum_max_Nms']:.3g}",
        "wheel momentum, final [N m s]": lambda row: f"{row['wheel_momentum_final_Nms']:.3g}",
        "wheel torque, max [N m]": lambda row: f"{row['wheel_torque_max_Nm']:.3g}",
        "wheel energy [J]": lambda row: f"{row['wheel_energy_J']:.3g}",
        "propellant [g]": lambda row: f"{1e3 * row['propellant_kg']:.3g}",
        "time, turning back too [s]": lambda row: f"{row['time_s']:.3g}",
        "base rotation, max [deg]": lambda row: f"{row['rotation_max_deg']:.3g}",
        "base rotation at arrival [deg]": lambda row: f"{row['rotation_at_arrival_deg']:.3g}",
        "carried off by turning back [mm]": lambda row: f"{1e3 * row['carried_m']:.3g}",
        "cost integral [s]": lambda row: f"{row['cost_integral_s']:.3g}",
        "joint travel [rad]": lambda row: f"{row['joint_travel_rad']:.3g}",
    }
    unused = "wheel" if thrusters_only else "propellant"
    used = {label: value for label, value in rows.items() if not label.startswith(unused)}
    return side_by_side(f"{name}: coupling used and fought", numbers, used)
