"""One scenario in several ways, side by side: planning methods, plants."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.table import Table

from ffsms_pin import scenarios
from ffsms_pin.cli import output
from ffsms_pin.cli.output import new_table, number_rows, printed
from ffsms_pin.plotting import save_formats
from ffsms_pin.plotting.comparisons import plot_comparison
from ffsms_pin.scenarios import Comparison, Scenario, scenario
from ffsms_pin.scenarios.comparisons import comparison_numbers
from ffsms_pin.scenarios.fits import SEARCH_OPTIONS
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
