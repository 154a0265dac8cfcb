"""`ffsms-pin view`: a results folder as an animated scene, in a file or in the browser."""

from __future__ import annotations

import argparse
import json
import os
import sys
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ffsms_pin.opt import Trajectory
    from ffsms_pin.system import SpaceManipulator

__all__ = ["add_parser", "run"]

_DESCRIPTION = """\
Show what `ffsms-pin run` wrote: the satellite and its arm in motion, with the coupling drawn on them. Writes
one HTML file that needs nothing else, not even a network; without --html it is view.html in the results.

examples:
  ffsms-pin view results/case-2                        write results/case-2/view.html, and open it
  ffsms-pin view results/case-2 --html out.html        write the file only
  ffsms-pin view results/case-2 --robot mine.urdf      a robot that was a file
"""


def add_parser(subparsers: Any) -> None:
    """Add `view` to the commands (argparse's subparsers)."""
    parser = subparsers.add_parser(
        "view",
        help="animate results in the browser, as one HTML file",
        description=_DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("results", metavar="RESULTS", help="folder that `ffsms-pin run` wrote")
    parser.add_argument("--html", metavar="FILE", help="write this file, and do not open it")
    parser.add_argument(
        "--plan", action="store_true", help="show the plan as planned, not the simulated motion"
    )
    parser.add_argument(
        "--robot",
        metavar="ROBOT",
        help="the robot, or the scenario file that names it, where the results cannot say",
    )
    parser.add_argument("--end-effector", metavar="FRAME", help="with --robot: the frame that is meant")
    parser.add_argument("--speed", type=float, default=1.0, help="2 plays twice as fast as true (default: 1)")
    parser.add_argument(
        "--show", metavar="LAYERS", help="what is visible at first: 'all', or names with commas between"
    )


def run(arguments: argparse.Namespace) -> int:
    """Write the scene, and open it unless a file was named; returns the exit code.

    Errors of the library are left to the caller, which prints them in one line.
    """
    # Imported only now: --help needs none of it.
    from ffsms_pin.cli.output import output_console
    from ffsms_pin.errors import ResultError
    from ffsms_pin.opt import Trajectory
    from ffsms_pin.simulation import Tracking
    from ffsms_pin.viewer import view

    folder = Path(arguments.results)
    if not folder.is_dir():
        raise ResultError(folder, "is not a folder of results; make one with `ffsms-pin run`")
    plan = Trajectory.load(folder / "trajectory.npz")
    summary = _summary(folder / "summary.json")
    sms = _robot(arguments, folder, summary)
    _check(sms, plan, folder)
    tracked = folder / "tracking.npz"
    result = plan if arguments.plan or not tracked.exists() else Tracking.load(tracked)
    show = None if arguments.show is None else [name.strip() for name in arguments.show.split(",")]
    scene = view(
        sms,
        result,
        plan,
        show="all" if show == ["all"] else show,
        speed=arguments.speed,
        title=str(summary.get("scenario", folder.name)),
    )
    out = folder / "view.html" if arguments.html is None else Path(arguments.html)
    scene.to_html(out)
    output_console().print(f"scene: {out}", markup=False, highlight=False, soft_wrap=True)
    if arguments.html is None and _desktop():
        webbrowser.open(out.resolve().as_uri())
    return 0


def _desktop() -> bool:
    """Whether there is a display to open a window on."""
    return sys.platform in ("darwin", "win32") or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    )


def _summary(path: Path) -> dict[str, Any]:
    """What summary.json says; nothing where it is not there."""
    from ffsms_pin.errors import ResultError

    try:
        found = json.loads(path.read_text("utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise ResultError(path, f"cannot be read ({error})") from None
    if not isinstance(found, dict):
        raise ResultError(path, "is not a summary of results")
    return found


def _robot(arguments: argparse.Namespace, folder: Path, summary: dict[str, Any]) -> SpaceManipulator:
    """The robot that the results belong to."""
    from ffsms_pin.errors import FfsmsError, ResultError
    from ffsms_pin.models import load
    from ffsms_pin.scenarios import scenario, scenario_names

    if arguments.robot is not None:
        if str(arguments.robot).endswith(".toml") or arguments.robot in scenario_names():
            return scenario(arguments.robot).load()
        return load(arguments.robot, end_effector=arguments.end_effector)
    name = summary.get("scenario")
    if name in scenario_names():
        return scenario(name).load()
    if "robot" not in summary:
        raise ResultError(folder, "does not say whose motion it is (no summary.json): add --robot ROBOT")
    try:
        return load(str(summary["robot"]), end_effector=arguments.end_effector)
    except FfsmsError as error:
        raise ResultError(
            folder, f"its robot cannot be loaded: {error}; add --robot with it or with its scenario file"
        ) from None


def _check(sms: SpaceManipulator, plan: Trajectory, folder: Path) -> None:
    """Raise `ResultError` unless the robot's end effector is where the plan says."""
    from ffsms_pin.errors import ResultError

    if plan.q.shape[1] == sms.nq:
        tip = sms.at(plan.q[0]).end_effector_pose.translation
        if abs(tip - plan.end_effector[0]).max() < 1e-6:
            return
    raise ResultError(
        folder,
        f"is not a motion of '{sms.model.name}' with the end effector '{sms.end_effector}': "
        "add --robot with the robot, or with the scenario file of the run",
    )
