"""`ffsms-pin robustness`: a scenario on many plants that are not its model."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.table import Table

from ffsms_pin.cli.allow_import import add_allow_import

__all__ = ["RESUMES", "add_parser", "run"]

RESUMES = True  # the same command goes on where it was stopped

_DESCRIPTION = """\
Follow a scenario's motion on random plants, with all else as the scenario says: once planned again in the
loop, once by the plan that was made for the model. Both methods meet the same plants. Prints one table, and
writes robustness.json and one figure (pdf and png). Runs that are done are kept in a folder beside the
results until these are written: the same command goes on where it was killed.

example: ffsms-pin robustness case-1 --plants 50 --jobs 2

exit codes: 0 done, however many arrived; 2 bad input; 70 a defect of ffsms-pin; 130 interrupted;
143 terminated
"""


def add_parser(subparsers: Any) -> None:
    """Add `robustness` to the commands (argparse's subparsers)."""
    parser = subparsers.add_parser(
        "robustness",
        help="follow a scenario on random plants, planned again and planned once",
        description=_DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "scenario", metavar="SCENARIO", help="a packaged one, as case-2, or a scenario file (TOML)"
    )
    parser.add_argument("--plants", type=int, metavar="N", default=200, help="how many (default: 200)")
    parser.add_argument("--seed", type=int, metavar="N", default=1, help="of the plants (default: 1)")
    parser.add_argument("--jobs", type=int, metavar="N", help="processes at once (default: one a core)")
    for name, default, what in (
        ("arm-mass", 0.2, "the mass of every body of the arm, inertia with it"),
        ("base-mass", 0.1, "the mass of the base"),
        ("base-inertia", 0.1, "the inertia of the base"),
    ):
        parser.add_argument(
            f"--{name}",
            type=float,
            metavar="SHARE",
            default=default,
            help=f"by what share {what} is off at most (default: {default:g})",
        )
    parser.add_argument(
        "--out", metavar="DIR", help="folder for the results (default: results/SCENARIO-robustness)"
    )
    add_allow_import(parser)


def run(arguments: argparse.Namespace) -> int:
    """Simulate, print the table and write the results; returns the exit code."""
    import shutil

    # Imported only now: --help needs none of it.
    from rich.console import Console

    from ffsms_pin.cli.output import output_console
    from ffsms_pin.cli.progress import shown_progress
    from ffsms_pin.cli.results_folder import chosen_folder, results_folder
    from ffsms_pin.engine import parts_folder
    from ffsms_pin.plotting import save_formats
    from ffsms_pin.plotting.robustness import plot_robustness
    from ffsms_pin.scenarios import robustness, scenario
    from ffsms_pin.scenarios.robustness import robustness_numbers
    from ffsms_pin.storage import write_content

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
        write_content(staging / "robustness.json", json.dumps(numbers, indent=2, allow_nan=False) + "\n")
        figure = plot_robustness(found)
        save_formats(figure, staging / "robustness")
    shutil.rmtree(parts, ignore_errors=True)
    output = output_console()
    output.print(_table(numbers))
    output.print(f"results: {folder}", markup=False, highlight=False, soft_wrap=True)
    return 0


def _table(numbers: dict[str, Any]) -> Table:
    from rich.markup import escape
    from rich.table import Table

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
