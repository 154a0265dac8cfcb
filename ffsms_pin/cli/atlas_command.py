"""`ffsms-pin atlas`: the coupling of a robot over its joint ranges or its workspace."""

from __future__ import annotations

import argparse
import shlex
import sys
from pathlib import Path
from typing import Any

from ffsms_pin.cli.work_arguments import add_work_arguments, work_arguments

__all__ = ["RESUMES", "add_parser", "run"]

RESUMES = True  # the same command goes on where it was stopped

_DESCRIPTION = """\
Sample a robot's configurations and measure at each: singular values and entropy of the coupling,
manipulability of J*, how far the base moves for a metre of the end effector, and the coupling assistance
along chosen directions. Writes an xarray dataset (Zarr), and figures where they are asked for. A run that was
killed goes on with the same command.

example: ffsms-pin atlas planar_3r --over workspace --samples 1000000 --out planar.zarr --figures planar

exit codes: 0 done; 2 bad input; 70 a defect of ffsms-pin; 130 interrupted; 143 terminated
"""


def add_parser(subparsers: Any) -> None:
    """Add `atlas` to the commands (argparse's subparsers)."""
    parser = subparsers.add_parser(
        "atlas",
        help="sample a robot's coupling over its joints or its workspace",
        description=_DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("model", metavar="MODEL", help="a robot by name, as planar_3r, or a URDF file")
    parser.add_argument("--end-effector", metavar="FRAME", help="its frame (default: the last link's)")
    parser.add_argument(
        "--over",
        choices=("joints", "workspace"),
        default="joints",
        help="one row a sample, or statistics in each cell of the workspace (default: joints)",
    )
    parser.add_argument(
        "--samples", type=int, metavar="N", default=100_000, help="how many (default: 100000)"
    )
    parser.add_argument(
        "--method",
        choices=("sobol", "grid"),
        default="sobol",
        help="points that fill the joint ranges evenly, or the same number on each joint (default: sobol)",
    )
    parser.add_argument("--seed", type=int, metavar="N", default=0, help="of the points (default: 0)")
    parser.add_argument(
        "--direction",
        nargs=3,
        type=float,
        action="append",
        default=[],
        metavar=("X", "Y", "Z"),
        help="for the coupling assistance, base axes; may be given several times",
    )
    parser.add_argument(
        "--cells", type=int, metavar="N", default=48, help="along the workspace's longest side (default: 48)"
    )
    parser.add_argument("--out", metavar="FILE", help="the dataset (default: MODEL-OVER.zarr)")
    parser.add_argument("--figures", metavar="DIR", help="folder for figures (pdf and png)")
    add_work_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Sample, and write the dataset and the figures; returns the exit code."""
    # Imported only now: --help needs none of it.
    from rich.console import Console

    from ffsms_pin.atlas import atlas, open_atlas
    from ffsms_pin.cli.output import output_console
    from ffsms_pin.cli.progress import shown_progress
    from ffsms_pin.extras import require
    from ffsms_pin.models import load

    if arguments.figures:
        require("plot", "figures of an atlas")
    sms = load(arguments.model, end_effector=arguments.end_effector)
    out = arguments.out or f"{Path(arguments.model).stem}-{arguments.over}.zarr"
    with shown_progress(Console(stderr=True)) as progress:
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
    output = output_console()
    if written is None:
        output.print(f"shard {arguments.shard}: done", markup=False, highlight=False)
        return 0
    if arguments.figures:
        _figures(open_atlas(written), Path(arguments.figures))
    output.print(f"atlas: {out}", markup=False, highlight=False, soft_wrap=True)
    return 0


def _figures(data: Any, folder: Path) -> None:
    from ffsms_pin.cli.results_folder import results_folder
    from ffsms_pin.plotting import save_formats
    from ffsms_pin.plotting.atlas import plot_atlas

    figure = plot_atlas(data)
    with results_folder(folder) as staging:
        save_formats(figure, staging / "atlas")
