"""`ffsms-pin atlas`: the coupling of a robot over its joint ranges or its workspace."""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path

from ffsms_pin.atlas import atlas, open_atlas
from ffsms_pin.cli.arguments import work_arguments
from ffsms_pin.cli.output import say
from ffsms_pin.cli.progress import shown_progress
from ffsms_pin.cli.results_folder import results_folder
from ffsms_pin.extras import require
from ffsms_pin.models import load

__all__ = ["run"]


def run(arguments: argparse.Namespace) -> int:
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
