"""The command `ffsms-pin campaign`: the runs of a scenario with drawn values."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from rich.table import Table

from ffsms_pin import campaigns
from ffsms_pin.cli import output
from ffsms_pin.cli.main import named
from ffsms_pin.cli.output import new_table, number_rows, printed, say, write_numbers
from ffsms_pin.errors import FfsmsError, InvalidValue, installed
from ffsms_pin.scenarios import scenario_names

_PERCENTILES = {"5 %": 5, "median": 50, "95 %": 95, "99 %": 99}
_METRICS = [
    ("final error{} [mm]", "final_error_m", 1e3),
    ("largest error on the path{} [mm]", "path_error_max_m", 1e3),
    ("largest joint error{} [mrad]", "joint_error_max_rad", 1e3),
    ("largest torque{} [N m]", "torque_max", 1.0),
    ("largest base rotation{} [deg]", "base_rotation_max_deg", 1.0),
]
_WORST = 5  # number of worst runs printed per method


def run(arguments: argparse.Namespace) -> int:
    """Run the campaign, write its table, report and figure, and print the report."""
    chosen, folder = _campaign_of_folder(arguments) if _is_folder(arguments) else _campaign_of_file(arguments)
    with output.shown_progress() as progress:
        work = {"jobs": arguments.jobs, "scheduler": arguments.scheduler}
        campaigns.campaign(chosen, folder, progress=partial(progress, "runs"), **work)
    table = campaigns.read_table(folder)
    numbers = campaigns.report(table)
    write_numbers(folder / "report.json", numbers)
    if installed("plot"):
        from ffsms_pin.plotting import save_formats
        from ffsms_pin.plotting.comparisons import plot_campaign

        save_formats(plot_campaign(table), folder / "report")
    else:
        say(output.NO_FIGURES)
    methods = numbers if chosen.compare else {"": numbers}
    title = f"{Path(chosen.source).stem}: {chosen.runs} runs"
    shown = _side_by_side(title, methods) if chosen.compare else _percentiles(title, numbers)
    remedy = f"to repeat one run: ffsms-pin run --replay {shlex.quote(str(folder))} SEED"
    return printed(folder, shown, *_worst(methods), remedy)


def _is_folder(arguments: argparse.Namespace) -> bool:
    return arguments.scenario not in scenario_names() and Path(arguments.scenario).is_dir()


def _campaign_of_folder(arguments: argparse.Namespace) -> tuple[campaigns.Campaign, Path]:
    """Return the campaign in a folder; --runs replaces the number of runs."""
    for name in ("seed", "out", "compare"):
        value = getattr(arguments, name)
        if value is not None and value is not False:  # 0 is a valid seed
            remedy = f"is already set by the campaign in {arguments.scenario}; leave it out to continue"
            raise InvalidValue(name, value, remedy)
    chosen = campaigns.Campaign.open(arguments.scenario, allow_import=arguments.allow_import)
    return replace(chosen, **named(arguments, "runs")), Path(arguments.scenario)


def _campaign_of_file(arguments: argparse.Namespace) -> tuple[campaigns.Campaign, Path]:
    """Return the campaign of a scenario file, and the folder for its results."""
    if arguments.runs is None:
        raise FfsmsError("a new campaign needs the number of its runs: add --runs N")
    options = named(arguments, "runs", "seed", "compare", "allow_import")
    chosen = campaigns.Campaign.read(arguments.scenario, **options)
    return chosen, output.chosen_folder(arguments.out, f"{Path(chosen.source).stem}-campaign")


def _percentiles(title: str, numbers: dict[str, Any]) -> Table:
    """Return a table with a column for each percentile; the caption has success rate and outcomes."""
    table = new_table(title, "quantity", *_PERCENTILES)
    columns = (
        {name: values[percentile] for name, values in numbers["percentiles"].items()}
        for percentile in _PERCENTILES.values()
    )
    number_rows(table, columns, [(label.format(""), key, factor) for label, key, factor in _METRICS])
    others = ", ".join(f"{count} {outcome}" for outcome, count in numbers["outcomes"].items())
    table.caption = (
        f"{100.0 * numbers['success_rate']:.4g} % arrived (95 % interval {_interval(numbers)} %): {others}"
    )
    table.caption_justify = "left"
    return table


def _side_by_side(title: str, methods: dict[str, dict[str, Any]]) -> Table:
    """Return a table with a column for each method."""
    table, columns = new_table(title, "quantity", *methods), methods.values()
    for outcome in dict.fromkeys(outcome for numbers in columns for outcome in numbers["outcomes"]):
        table.add_row(outcome, *(str(numbers["outcomes"].get(outcome, 0)) for numbers in columns))
    table.add_row("success rate, 95 % interval \\[%]", *map(_interval, columns))
    for name, percentile in (("median", 50), ("95 %", 95)):
        values = [
            {key: row[percentile] for key, row in numbers["percentiles"].items()} for numbers in columns
        ]
        number_rows(
            table, values, [(label.format(f", {name}"), key, factor) for label, key, factor in _METRICS]
        )
    return table


def _interval(numbers: dict[str, Any]) -> str:
    """Return the 95 % interval of the success rate in percent."""
    low, high = (100.0 * share for share in numbers["success_rate_95_percent"])
    return f"{low:.4g} to {high:.4g}"


def _worst(methods: dict[str, dict[str, Any]]) -> Iterator[str]:
    """Yield seed, method, outcome, error and reason of the `_WORST` worst runs of each method."""
    for method, numbers in methods.items():
        for row in numbers["worst"][:_WORST]:
            error, label = row["final_error_m"], "final error"
            if "path_error_max_m" in row:
                error, label = row["path_error_max_m"], "largest error on the path"
            size = "" if error is None else f", {label} {1e3 * error:.3g} mm"
            reason = f": {row['error']}" if row["error"] else ""
            yield f"seed {row['seed']}{method and ', ' + method}: {row['outcome']}{size}{reason}"
