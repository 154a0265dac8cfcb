"""`ffsms-pin atlas` and `ffsms-pin sweep`: the coupling of a robot, and of changed designs of it."""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path

import numpy as np
from rich.markup import escape
from rich.table import Column, Table

from ffsms_pin.atlas import Sweep, atlas, open_atlas, sweep
from ffsms_pin.cli.arguments import work_arguments
from ffsms_pin.cli.output import printed, say, shown_progress
from ffsms_pin.cli.results_folder import chosen_folder, results_folder, write_numbers
from ffsms_pin.errors import InvalidValue
from ffsms_pin.extras import require
from ffsms_pin.models import load
from ffsms_pin.version import __version__


def sample(arguments: argparse.Namespace) -> int:
    """Sample, and write the dataset and the figures."""
    if arguments.figures:
        require("plot", "figures of an atlas")
    sms = load(arguments.model, end_effector=arguments.end_effector)
    out = arguments.out or f"{Path(arguments.model).stem}-{arguments.over}.zarr"
    with shown_progress() as progress:
        written = atlas(
            sms,
            out,
            arguments.samples,
            arguments.over,
            method=arguments.method,
            seed=arguments.seed,
            directions=arguments.direction,
            cells=arguments.cells,
            progress=lambda done, whole: progress("samples", done / whole),
            provenance={"command": shlex.join(["ffsms-pin", *sys.argv[1:]])},
            **work_arguments(arguments),
        )
    if written is None:
        say(f"shard {arguments.shard}: done")
        return 0
    if arguments.figures:
        from ffsms_pin.plotting import save_formats
        from ffsms_pin.plotting.atlas import plot_atlas

        figure = plot_atlas(open_atlas(written))
        with results_folder(Path(arguments.figures)) as staging:
            save_formats(figure, staging / "atlas")
    say(f"atlas: {out}")
    return 0


def designs(arguments: argparse.Namespace) -> int:
    """Measure, print the table and write the results."""
    require("plot", "the figure of a sweep")
    sms = load(arguments.model, end_effector=arguments.end_effector, wheels=arguments.wheel)
    parameters = dict(_parameter(text) for text in arguments.vary)
    folder = chosen_folder(arguments.out, f"{Path(arguments.model).stem}-sweep")
    with shown_progress() as progress:
        found = sweep(
            sms,
            parameters,
            folder,
            arguments.samples,
            seed=arguments.seed,
            progress=lambda done, whole: progress("designs", done / whole),
            **work_arguments(arguments),
        )
    if found is None:
        say(f"shard {arguments.shard}: done")
        return 0
    _write(found, folder, sms.model.name)
    return printed(folder, _table(found))


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
        "command": shlex.join(["ffsms-pin", *sys.argv[1:]]),
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


def _table(found: Sweep) -> Table:
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
