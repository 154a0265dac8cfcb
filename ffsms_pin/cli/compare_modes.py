"""`ffsms-pin compare-modes`: the base held by wheels, and left to float."""

from __future__ import annotations

import argparse

from rich.console import Console

from ffsms_pin.cli.output import Rows, output_console, say, side_by_side
from ffsms_pin.cli.progress import shown_progress
from ffsms_pin.cli.results_folder import chosen_folder, results_folder, write_results
from ffsms_pin.plotting.wheels import plot_modes
from ffsms_pin.scenarios import scenario
from ffsms_pin.scenarios.modes import compare_modes, mode_numbers

__all__ = ["run"]


def run(arguments: argparse.Namespace) -> int:
    """Plan, print the table and write the results."""
    chosen = scenario(arguments.scenario, allow_import=arguments.allow_import)
    folder = chosen_folder(arguments.out, f"{chosen.name}-modes")
    with results_folder(folder) as staging, shown_progress(Console(stderr=True)) as progress:
        comparison = compare_modes(chosen, progress)
        numbers = mode_numbers(comparison.found)
        write_results(staging / "modes", numbers, plot_modes(comparison))
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
    unused = "wheel" if comparison.sms.wheels is None else "propellant"
    used = {label: value for label, value in rows.items() if not label.startswith(unused)}
    output_console().print(side_by_side(f"{chosen.name}: coupling used and fought", numbers, used))
    say(
        *(f"{name} has not reached: {row['note']}" for name, row in numbers.items() if not row["reached"]),
        f"results: {folder}",
    )
    return 0
