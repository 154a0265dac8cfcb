"""One scenario in several ways, side by side: planning methods, modes of the base, control laws, plants."""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from rich import box
from rich.markup import escape
from rich.table import Table

from ffsms_pin.cli.output import Rows, new_table, output_console, say, side_by_side
from ffsms_pin.cli.progress import shown_progress
from ffsms_pin.cli.results_folder import chosen_folder, results_folder, write_numbers
from ffsms_pin.control import LAWS
from ffsms_pin.engine import parts_folder
from ffsms_pin.plotting import save_formats
from ffsms_pin.plotting.comparisons import plot_comparison, plot_laws, plot_modes, plot_robustness
from ffsms_pin.scenarios import Scenario, compare_laws, robustness, scenario
from ffsms_pin.scenarios.comparisons import compare, compare_modes, comparison_numbers, law_numbers
from ffsms_pin.scenarios.plants import robustness_numbers
from ffsms_pin.scenarios.run import StageProgress
from ffsms_pin.studies.modes import mode_numbers

__all__ = ["laws", "methods", "modes", "plants"]

Found = TypeVar("Found")


def methods(arguments: argparse.Namespace) -> int:
    """`ffsms-pin compare`: the planning methods."""
    chosen, folder = _chosen(arguments, "comparison")
    wanted = tuple(arguments.methods) if arguments.methods else None
    found, numbers = _written(
        folder,
        "comparison",
        lambda progress: compare(chosen, wanted, progress),
        comparison_numbers,
        plot_comparison,
    )
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
    left_out = [f"left out: {method}, which {why}" for method, why in found.left_out.items()]
    say(*_not_reached(numbers), *left_out, f"results: {folder}")
    return 0


def modes(arguments: argparse.Namespace) -> int:
    """`ffsms-pin compare-modes`: the base held by wheels, and left to float."""
    chosen, folder = _chosen(arguments, "modes")
    found, numbers = _written(
        folder,
        "modes",
        lambda progress: compare_modes(chosen, progress),
        lambda comparison: mode_numbers(comparison.found),
        plot_modes,
    )
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
    unused = "wheel" if found.sms.wheels is None else "propellant"
    used = {label: value for label, value in rows.items() if not label.startswith(unused)}
    output_console().print(side_by_side(f"{chosen.name}: coupling used and fought", numbers, used))
    say(*_not_reached(numbers), f"results: {folder}")
    return 0


def laws(arguments: argparse.Namespace) -> int:
    """`ffsms-pin laws`: the control laws."""
    chosen, folder = _chosen(arguments, "laws")
    wanted = tuple(dict.fromkeys(arguments.laws)) if arguments.laws else tuple(LAWS)
    found, numbers = _written(
        folder, "laws", lambda progress: compare_laws(chosen, wanted, progress), law_numbers, plot_laws
    )
    output_console().print(_law_table(chosen.name, numbers))
    for law, row in numbers.items():
        say(*_law_warnings(law, row, found.plan.duration))
    say(f"results: {folder}")
    return 0


def plants(arguments: argparse.Namespace) -> int:
    """`ffsms-pin robustness`: a scenario on many plants that are not its model."""
    chosen, folder = _chosen(arguments, "robustness")
    parts = parts_folder(folder)
    _, numbers = _written(
        folder,
        "robustness",
        lambda progress: robustness(
            chosen,
            arguments.plants,
            arguments.seed,
            arm_mass=arguments.arm_mass,
            base_mass=arguments.base_mass,
            base_inertia=arguments.base_inertia,
            jobs=arguments.jobs,
            folder=parts,
            progress=progress,
        ),
        robustness_numbers,
        plot_robustness,
    )
    shutil.rmtree(parts, ignore_errors=True)
    output_console().print(_plant_table(numbers))
    say(f"results: {folder}")
    return 0


def _chosen(arguments: argparse.Namespace, what: str) -> tuple[Scenario, Path]:
    """The scenario, and the folder of its results."""
    chosen = scenario(arguments.scenario, allow_import=arguments.allow_import)
    return chosen, chosen_folder(arguments.out, f"{chosen.name}-{what}")


def _written(
    folder: Path,
    name: str,
    compared: Callable[[StageProgress], Found],
    numbers_of: Callable[[Found], dict[str, Any]],
    plot: Callable[[Found], Any],
) -> tuple[Found, dict[str, Any]]:
    """What was compared and its numbers, these and their figure written to the folder under a name."""
    with results_folder(folder) as staging, shown_progress() as progress:
        found = compared(progress)
        numbers = numbers_of(found)
        write_numbers(staging / f"{name}.json", numbers)
        save_formats(plot(found), staging / name)
    return found, numbers


def _not_reached(numbers: dict[str, dict[str, Any]]) -> list[str]:
    return [f"{name} has not reached: {row['note']}" for name, row in numbers.items() if not row["reached"]]


def _law_warnings(law: str, row: dict[str, Any], duration: float) -> list[str]:
    """What a user of a law should know, one line each."""
    found = []
    if row["slow"]:
        found.append(
            f"warning: {law}: with its gains an error dies out within {row['longest_time_constant_s']:.3g} s,"
            f" the move takes only {duration:g} s"
        )
    if row["stopped"]:
        found.append(f"warning: {law}: {row['stopped']}")
    return found


def _law_table(name: str, numbers: dict[str, dict[str, Any]]) -> Table:
    # Names may be read over two lines, and there are no lines between columns: it fits 80 columns.
    table = Table(
        title=escape(f"{name}: control laws side by side"),
        title_justify="left",
        box=box.SIMPLE_HEAD,
        show_edge=False,
        padding=(0, 1, 0, 0),
    )
    table.add_column("quantity", no_wrap=True)
    for law in numbers:
        table.add_column(law.replace("-", "-\n"), justify="right", no_wrap=True)
    rows = numbers.values()

    def add(words: str, key: str, factor: float = 1.0) -> None:
        table.add_row(words, *(f"{factor * row[key]:.3g}" if key in row else "-" for row in rows))

    arrived = ("[red]stopped[/]" if r["stopped"] else "yes" if r["arrived"] else "[red]no[/]" for r in rows)
    table.add_row("arrived", *arrived)
    add("error at the end \\[mm]", "final_error_m", 1e3)
    for unit in ("rad", "m"):
        for when, words in (("max", "max"), ("final", "end")):
            key = f"joint_error_{when}_{unit}"
            if any(key in row for row in rows):
                add(f"joint error, {words} \\[m{unit}]", key, 1e3)
    add("effort \\[N²m²s]", "effort_N2m2s")
    add("chatter \\[N²m²/s]", "chatter_N2m2_per_s")
    key = "longest_time_constant_s"
    constants = (f"[red]{row[key]:.3g} (slow)[/]" if row["slow"] else f"{row[key]:.3g}" for row in rows)
    table.add_row("time constant \\[s]", *constants)
    return table


def _plant_table(numbers: dict[str, Any]) -> Table:
    methods = numbers["methods"]
    table = new_table(f"{numbers['scenario']}: {numbers['plants']} random plants", "quantity", *methods)
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
