"""`ffsms-pin laws`: the control laws side by side."""

from __future__ import annotations

import argparse
from typing import Any

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ffsms_pin.cli.output import output_console, say
from ffsms_pin.cli.progress import shown_progress
from ffsms_pin.cli.results_folder import chosen_folder, results_folder, write_results
from ffsms_pin.control import LAWS
from ffsms_pin.plotting.comparisons import plot_laws
from ffsms_pin.scenarios import compare_laws, scenario
from ffsms_pin.scenarios.compare import law_numbers

__all__ = ["run"]


def run(arguments: argparse.Namespace) -> int:
    """Simulate, print the table and write the results."""
    chosen = scenario(arguments.scenario, allow_import=arguments.allow_import)
    laws = tuple(dict.fromkeys(arguments.laws)) if arguments.laws else tuple(LAWS)
    folder = chosen_folder(arguments.out, f"{chosen.name}-laws")
    with results_folder(folder) as staging, shown_progress(Console(stderr=True)) as progress:
        comparison = compare_laws(chosen, laws, progress)
        numbers = law_numbers(comparison)
        write_results(staging / "laws", numbers, plot_laws(comparison))
    output_console().print(_table(chosen.name, numbers))
    for law, row in numbers.items():
        say(*_warnings(law, row, comparison.plan.duration))
    say(f"results: {folder}")
    return 0


def _warnings(law: str, row: dict[str, Any], duration: float) -> list[str]:
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


def _table(name: str, numbers: dict[str, dict[str, Any]]) -> Table:
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
