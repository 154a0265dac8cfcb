"""One scenario in several ways, side by side: planning methods, plants."""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.table import Table

from ffsms_pin import scenarios
from ffsms_pin.cli import output
from ffsms_pin.cli.main import named
from ffsms_pin.cli.output import new_table, number_rows, printed
from ffsms_pin.engine import parts_folder
from ffsms_pin.plotting import save_formats
from ffsms_pin.plotting.comparisons import plot_comparison, plot_robustness
from ffsms_pin.scenarios import Comparison, Scenario, scenario
from ffsms_pin.scenarios.comparisons import comparison_numbers
from ffsms_pin.scenarios.fits import SEARCH_OPTIONS
from ffsms_pin.scenarios.plants import robustness_numbers
from ffsms_pin.scenarios.run import StageProgress


def methods(arguments: argparse.Namespace) -> int:
    """`ffsms-pin compare`: the planning methods."""
    wanted = tuple(arguments.methods) if arguments.methods else None
    with _results(arguments, "comparison") as (chosen, folder, progress, write):
        found = scenarios.compare(chosen, wanted, progress)
        write(numbers := comparison_numbers(found), plot_comparison(found))
    rows = [
        ("final error [mm]", "final_error_m", 1e3),
        ("cost integral [s]", "cost_integral_s", 1.0),
        ("joint travel [rad]", "joint_travel_rad", 1.0),
        ("path over straight line", "path_over_straight", 1.0),
        ("joint effort [rad²/s]", "joint_effort_rad2_per_s", 1.0),
        ("torque effort [N²m²s]", "torque_effort_N2m2s", 1.0),
        ("base rotation, max [deg]", "rotation_max_deg", 1.0),
        ("base translation, max [mm]", "translation_max_m", 1e3),
        ("peak joint rate [rad/s]", "peak_rate_rad_per_s", 1.0),
        ("computing time [s]", "planning_s", 1.0),
    ]
    table = _side_by_side(f"{found.scenario.name}: methods side by side", numbers, rows)
    searched = [key for key in SEARCH_OPTIONS if key in found.scenario.plan]
    alone = [f"only horizon takes {', '.join(searched)} of [plan]"] if searched else []
    return printed(folder, table, *_not_reached(numbers), *_left_out(found), *alone)


def plants(arguments: argparse.Namespace) -> int:
    """`ffsms-pin robustness`: a scenario on many plants that are not its model."""
    how = named(arguments, "plants", "seed", "arm_mass", "base_mass", "base_inertia", "jobs")
    with _results(arguments, "robustness") as (chosen, folder, progress, write):
        found = scenarios.robustness(chosen, folder=parts_folder(folder), progress=progress, **how)
        write(numbers := robustness_numbers(found), plot_robustness(found))
    shutil.rmtree(parts_folder(folder), ignore_errors=True)
    return printed(folder, _plant_table(numbers))


@contextmanager
def _results(
    arguments: argparse.Namespace, name: str
) -> Iterator[tuple[Scenario, Path, StageProgress, Callable[[Any, Any], None]]]:
    """The scenario, the folder of results, progress, and what writes numbers and a figure under a name."""
    chosen = scenario(arguments.scenario, allow_import=arguments.allow_import)
    folder = output.chosen_folder(arguments.out, f"{chosen.name}-{name}")
    with output.results_folder(folder) as staging, output.shown_progress() as progress:

        def write(numbers: Any, figure: Any) -> None:
            output.write_numbers(staging / f"{name}.json", numbers)
            save_formats(figure, staging / name)

        yield chosen, folder, progress, write


def _left_out(found: Comparison) -> list[str]:
    return [f"left out: {name}, which {why}" for name, why in found.left_out.items()]


def _not_reached(numbers: dict[str, dict[str, Any]]) -> list[str]:
    return [f"{name} has not reached: {row['note']}" for name, row in numbers.items() if not row["reached"]]


def _side_by_side(
    title: str, numbers: dict[str, dict[str, Any]], rows: list[tuple[str, str, float]]
) -> Table:
    """A column for each motion: whether it reaches its target, and a line for each of the rows."""
    table = new_table(title, "quantity", *numbers)
    table.add_row("reached", *("yes" if row["reached"] else "no" for row in numbers.values()))
    number_rows(table, numbers.values(), rows)
    return table


def _plant_table(numbers: dict[str, Any]) -> Table:
    methods, plants = numbers["methods"], numbers["plants"]
    columns = methods.values()
    table = new_table(f"{numbers['scenario']}: {plants} random plants", "quantity", *methods)
    arrived = (f"{row['arrived']} of {plants}" for row in columns)
    table.add_row(f"within {1e3 * numbers['reach_m']:g} mm at the end", *arrived)
    intervals = ([100.0 * share for share in row["arrived_95_percent_interval"]] for row in columns)
    shares = (f"{low:.1f} to {high:.1f}" for low, high in intervals)
    table.add_row("share of all plants, 95 % interval \\[%]", *shares)
    if any(row["stopped"] for row in columns):
        table.add_row("stopped on the way", *(str(row["stopped"]) for row in columns))
    errors = [
        ("final error, median [mm]", "final_error_median_m", 1e3),
        ("final error, 95 % of the plants [mm]", "final_error_95_percent_m", 1e3),
        ("final error, worst [mm]", "final_error_worst_m", 1e3),
    ]
    number_rows(table, columns, errors)
    return table
