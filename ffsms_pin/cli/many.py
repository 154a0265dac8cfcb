"""Work in chunks: `ffsms-pin campaign` and `merge`, a scenario many times; `atlas` and `sweep` of a robot."""

from __future__ import annotations

import argparse
import shlex
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.markup import escape
from rich.table import Column, Table

import ffsms_pin.campaigns as campaigns
from ffsms_pin.campaigns.report import report_numbers
from ffsms_pin.cli import output
from ffsms_pin.cli.main import named, work_arguments
from ffsms_pin.cli.output import chosen_folder, new_table, number_rows, printed, say, write_numbers
from ffsms_pin.errors import InvalidValue, ResultError
from ffsms_pin.extras import installed, require
from ffsms_pin.models import load
from ffsms_pin.version import __version__

if TYPE_CHECKING:
    from ffsms_pin.atlas import Sweep

_SHOWN = 5  # of the worst runs


def campaign(arguments: argparse.Namespace) -> int:
    """Run the campaign, and where it is complete, make table, report and figures."""
    work = work_arguments(arguments)
    how = named(arguments, "runs", "seed", "allow_import")
    chosen = campaigns.Campaign.read(arguments.scenario, **how)
    folder = chosen_folder(arguments.out, f"{chosen.source.stem}-campaign")
    with output.shown_progress() as progress:
        place = campaigns.campaign(chosen, folder, progress=partial(progress, "runs"), **work)
    if arguments.shard is None:
        return _merged(folder)
    missing = len(place.missing())
    words = f"{missing} chunks are missing still" if missing else "all shards are done"
    say(f"shard {arguments.shard} is done; {words}; the table: ffsms-pin merge {folder}")
    return 0


def merge(arguments: argparse.Namespace) -> int:
    """Make the table, and print the report."""
    folder = Path(arguments.folder)
    if not folder.is_dir():
        raise ResultError(folder, "is not the folder of a campaign; make one with `ffsms-pin campaign`")
    return _merged(folder, arguments.partial)


def _merged(folder: Path, partial: bool = False) -> int:
    """Merge a campaign, write its report and figures into its folder, and print the report; the exit code."""
    campaigns.merge(folder, partial=partial)
    found = campaigns.report(folder)
    write_numbers(folder / "report.json", report_numbers(found))
    if installed("plot"):
        from ffsms_pin.plotting import save_formats
        from ffsms_pin.plotting.comparisons import plot_campaign

        save_formats(plot_campaign(found), folder / "report")
    else:
        say(output.NO_FIGURES)
    worst = []
    for row in found.worst[:_SHOWN]:
        error = row["final_error_m"]
        end = "" if error is None else f", {1e3 * error:.3g} mm from the target"
        why = f": {row['error']}" if row["error"] else ""
        worst.append(f"seed {row['seed']}: {row['outcome']}{end}{why}")
    alone = f"one of them alone: ffsms-pin run --replay {folder} SEED"
    return printed(folder, _table(found, folder.name), *worst, alone)


def _table(found: campaigns.Report, name: str) -> Table:
    shown = (5, 50, 95, 99)
    table = new_table(f"{name}: {found.runs} runs", "quantity", "5 %", "median", "95 %", "99 %")
    rows = [
        ("final error [mm]", "final_error_m", 1e3),
        ("largest joint error [mrad]", "joint_error_max_rad", 1e3),
        ("largest torque [Nm]", "torque_max", 1.0),
        ("largest turn of the base [deg]", "base_rotation_max_deg", 1.0),
    ]
    number_rows(table, ({key: row[i] for key, row in found.percentiles.items()} for i in shown), rows)
    low, high = (100.0 * share for share in found.interval)
    others = ", ".join(f"{count} {name}" for name, count in found.outcomes.items() if count)
    table.caption = (
        f"{100.0 * found.success:.4g} % arrived (95 % interval {low:.4g} to {high:.4g} %): {others}"
    )
    table.caption_justify = "left"
    return table


def sample(arguments: argparse.Namespace) -> int:
    """Sample, and write the dataset and the figures."""
    from ffsms_pin.atlas import atlas, open_atlas  # loads half a second of statistics

    if arguments.figures:
        require("plot", "figures of an atlas")
    sms = load(arguments.model, end_effector=arguments.end_effector)
    out = arguments.out or f"{Path(arguments.model).stem}-{arguments.over}.zarr"
    with output.shown_progress() as progress:
        how = named(arguments, "samples", "over", "method", "seed", "cells") | work_arguments(arguments)
        how |= {"progress": partial(progress, "samples"), "provenance": {"command": _command()}}
        written = atlas(sms, out, directions=arguments.direction, **how)
    if written is None:
        say(f"shard {arguments.shard}: done")
        return 0
    if arguments.figures:
        from ffsms_pin.plotting import save_formats
        from ffsms_pin.plotting.atlas import plot_atlas

        figure = plot_atlas(open_atlas(written))
        with output.results_folder(Path(arguments.figures)) as staging:
            save_formats(figure, staging / "atlas")
    say(f"atlas: {out}")
    return 0


def designs(arguments: argparse.Namespace) -> int:
    """Measure, print the table and write the results."""
    from ffsms_pin.atlas import sweep

    require("plot", "the figure of a sweep")
    sms = load(arguments.model, end_effector=arguments.end_effector, wheels=arguments.wheel)
    parameters = dict(_parameter(text) for text in arguments.vary)
    folder = chosen_folder(arguments.out, f"{Path(arguments.model).stem}-sweep")
    with output.shown_progress() as progress:
        how = named(arguments, "samples", "seed") | work_arguments(arguments)
        found = sweep(sms, parameters, folder, progress=partial(progress, "designs"), **how)
    if found is None:
        say(f"shard {arguments.shard}: done")
        return 0
    _write(found, folder, sms.model.name)
    return printed(folder, _designs_table(found))


def _command() -> str:
    """The command line as it was given."""
    return shlex.join(["ffsms-pin", *sys.argv[1:]])


def _parameter(text: str) -> tuple[str, list[float]]:
    """Name and values of "name=1,2,3" or "name=first:last:count"."""
    name, _, values = text.rpartition("=")
    try:
        if ":" in values:
            first, last, count = values.split(":")
            if 1 <= int(count) <= 10_000:
                return name, np.linspace(float(first), float(last), int(count)).tolist()
        elif name:
            return name, [float(value) for value in values.split(",")]
    except ValueError:
        pass
    raise InvalidValue("--vary", text, "must be NAME=value,value,... or NAME=first:last:count")


def _write(found: Sweep, folder: Path, model: str) -> None:
    from ffsms_pin.plotting import save_formats
    from ffsms_pin.plotting.atlas import plot_pareto
    from ffsms_pin.plotting.style import stack

    content = {
        "model": model,
        "source": f"ffsms-pin {__version__}",
        "command": _command(),
        "parameters": {name: values.tolist() for name, values in found.parameters.items()},
        "statistics": {name: values.tolist() for name, values in found.statistics.items()},
        "not_beaten": found.best().tolist(),
    }
    write_numbers(folder / "sweep.json", content)
    motions = [name for name in ("base_rotation", "wheel_momentum") if name in found.statistics]
    figure, panels = stack(len(motions))
    for motion, panel in zip(motions, panels, strict=True):
        plot_pareto(found, motion, ax=panel)
    save_formats(figure, folder / "pareto")


def _designs_table(found: Sweep) -> Table:
    best = found.best()
    title = f"{int(best.sum())} of {len(found)} designs are not beaten in both reach and base rotation"
    wanted = ("reach", "base_rotation", "base_translation", "wheel_momentum", "entropy")
    shown = [name for name in wanted if name in found.statistics]
    columns = (Column(escape(name), justify="right") for name in (*found.parameters, *shown))
    table = Table(*columns, title=title, title_justify="left")
    rows = [*found.parameters.values(), *(found.statistics[name] for name in shown)]
    for i in sorted(np.flatnonzero(best), key=lambda i: found.statistics["reach"][i]):
        table.add_row(*(f"{row[i]:.4g}" for row in rows))
    return table
