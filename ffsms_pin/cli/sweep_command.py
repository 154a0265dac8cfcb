"""`ffsms-pin sweep`: designs of a robot side by side."""

from __future__ import annotations

import argparse
import json
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ffsms_pin.cli.work_arguments import add_work_arguments, work_arguments
from ffsms_pin.errors import InvalidValue

if TYPE_CHECKING:
    from rich.table import Table

    from ffsms_pin.atlas import Sweep

__all__ = ["RESUMES", "add_parser", "run"]

RESUMES = True  # the same command goes on where it was stopped

_DESCRIPTION = """\
Change a robot's design, and measure each combination: reach, base motion for a metre of the end effector,
entropy and manipulability; with --wheel, also what the wheels would have to hold. Prints the designs that no
other one beats both in reach and in base rotation, and writes sweep.json and one figure (pdf and png).

  --vary base_mass=0.5,1,2        factor of the base's mass, its inertia in proportion
  --vary base_inertia=0.5,1,2     factor of its inertia besides
  --vary mount_y=0,0.2            shift of the mount point, base axes [m]; also mount_x, mount_z
  --vary link:joint_2=0.8:1.2:5   factor of the length of the link behind a joint; first:last:count

example: ffsms-pin sweep planar_3r --vary base_mass=0.5,1,2,4 --vary link:joint_2=0.8:1.2:5

exit codes: 0 done; 2 bad input; 70 a defect of ffsms-pin; 130 interrupted; 143 terminated
"""


def add_parser(subparsers: Any) -> None:
    """Add `sweep` to the commands (argparse's subparsers)."""
    parser = subparsers.add_parser(
        "sweep",
        help="measure changed designs of a robot",
        description=_DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("model", metavar="MODEL", help="a robot by name, as planar_3r, or a URDF file")
    parser.add_argument("--end-effector", metavar="FRAME", help="its frame (default: the last link's)")
    parser.add_argument(
        "--wheel",
        action="append",
        default=[],
        metavar="JOINT",
        help="a continuous joint of the URDF file that is a reaction wheel; again for each wheel",
    )
    parser.add_argument(
        "--vary", action="append", required=True, metavar="NAME=VALUES", help="a parameter; see above"
    )
    parser.add_argument(
        "--samples", type=int, metavar="N", default=16384, help="configurations a design (default: 16384)"
    )
    parser.add_argument("--seed", type=int, metavar="N", default=0, help="of the configurations (default: 0)")
    parser.add_argument("--out", metavar="DIR", help="folder for the results (default: results/MODEL-sweep)")
    add_work_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    """Measure, print the table and write the results; returns the exit code."""
    from rich.console import Console

    from ffsms_pin.atlas import sweep
    from ffsms_pin.cli.output import output_console
    from ffsms_pin.cli.progress import shown_progress
    from ffsms_pin.cli.results_folder import chosen_folder
    from ffsms_pin.extras import require
    from ffsms_pin.models import load

    require("plot", "the figure of a sweep")
    sms = load(arguments.model, end_effector=arguments.end_effector, wheels=arguments.wheel)
    parameters = dict(_parameter(text) for text in arguments.vary)
    folder = chosen_folder(arguments.out, f"{Path(arguments.model).stem}-sweep")
    with shown_progress(Console(stderr=True)) as progress:
        found = sweep(
            sms,
            parameters,
            folder,
            arguments.samples,
            seed=arguments.seed,
            progress=lambda done, whole: progress("designs", done / whole),
            **work_arguments(arguments),
        )
    output = output_console()
    if found is None:
        output.print(f"shard {arguments.shard}: done", markup=False, highlight=False)
        return 0
    _write(found, folder, sms.model.name)
    output.print(_table(found))
    output.print(f"results: {folder}", markup=False, highlight=False, soft_wrap=True)
    return 0


def _parameter(text: str) -> tuple[str, list[float]]:
    """Name and values of "name=1,2,3" or "name=first:last:count"."""
    import numpy as np

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
    from ffsms_pin.storage import write_content
    from ffsms_pin.version import __version__

    content = {
        "model": model,
        "source": f"ffsms-pin {__version__}",
        "command": shlex.join(["ffsms-pin", *sys.argv[1:]]),
        "parameters": {name: values.tolist() for name, values in found.parameters.items()},
        "statistics": {name: values.tolist() for name, values in found.statistics.items()},
        "not_beaten": found.best().tolist(),
    }
    write_content(folder / "sweep.json", json.dumps(content, indent=2, allow_nan=False) + "\n")
    motions = [name for name in ("base_rotation", "wheel_momentum") if name in found.statistics]
    figure, panels = stack(len(motions))
    for motion, panel in zip(motions, panels, strict=True):
        plot_pareto(found, motion, ax=panel)
    save_formats(figure, folder / "pareto")


def _table(found: Sweep) -> Table:
    from rich.markup import escape
    from rich.table import Table

    best = found.best()
    title = f"{int(best.sum())} of {len(found)} designs are not beaten in both reach and base rotation"
    table = Table(title=title, title_justify="left")
    wanted = ("reach", "base_rotation", "base_translation", "wheel_momentum", "entropy")
    shown = [name for name in wanted if name in found.statistics]
    for name in (*found.parameters, *shown):
        table.add_column(escape(name), justify="right")
    columns = [*found.parameters.values(), *(found.statistics[name] for name in shown)]
    order = sorted((i for i in range(len(found)) if best[i]), key=lambda i: found.statistics["reach"][i])
    for i in order:
        table.add_row(*(f"{column[i]:.4g}" for column in columns))
    return table
