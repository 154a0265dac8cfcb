"""`ffsms-pin view`: a results folder as an animated scene, in a file or in the browser."""

from __future__ import annotations

import argparse
import os
import sys
import webbrowser
from pathlib import Path
from typing import Any

__all__ = ["add_parser", "desktop", "run"]

_DESCRIPTION = """\
Show what `ffsms-pin run` wrote: the satellite and its arm in motion, with the coupling drawn on them, and
obstacles, client, wheels and thrusters. Writes one HTML file that needs nothing else, not even a network;
without --html it is view.html in the results. With --record it writes a film instead.

examples:
  ffsms-pin view results/case-2                        write results/case-2/view.html, and open it
  ffsms-pin view results/case-2 --html out.html        write the file only
  ffsms-pin view results/capture --record out.gif --speed 2 --camera side
  ffsms-pin view results/case-2 --robot mine.urdf      a robot that was a file

Recording needs Chromium or Chrome, which draws without a window, and pip install 'ffsms-pin[record]'.
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
    parser.add_argument(
        "--speed", type=float, default=1.0, metavar="TIMES", help="2 plays twice as fast as true (default: 1)"
    )
    parser.add_argument(
        "--camera",
        metavar="VIEW",
        default="free",
        help="where it is looked at from first: free, front (from +x), side (from -y), top, or base, which "
        "turns with the base (default: free)",
    )
    parser.add_argument(
        "--show", metavar="LAYERS", help="what is visible at first: 'all', or names with commas between"
    )
    film = parser.add_argument_group("films")
    film.add_argument("--record", metavar="FILE", help="write a film of one pass, to a .gif or .mp4")
    film.add_argument("--fps", type=float, metavar="N", help="pictures a second (default: 20; mp4: 30)")
    film.add_argument(
        "--size", metavar="WxH", default="800x600", help="of the pictures in pixels (default: 800x600)"
    )
    film.add_argument("--browser", metavar="PROGRAM", help="Chromium or Chrome (default: the first found)")


def run(arguments: argparse.Namespace) -> int:
    """Write the scene, and open it unless a file was named; returns the exit code.

    Errors of the library are left to the caller, which prints them in one line.
    """
    # Imported only now: --help needs none of it.
    from rich.console import Console

    from ffsms_pin.cli.output import output_console
    from ffsms_pin.cli.progress import shown_progress
    from ffsms_pin.cli.viewed import scene_of
    from ffsms_pin.errors import InvalidValue

    if arguments.record is not None and arguments.html is not None:
        raise InvalidValue("--html", arguments.html, "writes a page and --record a film: give one of them")
    folder = Path(arguments.results)
    show = None if arguments.show is None else [name.strip() for name in arguments.show.split(",")]
    scene = scene_of(
        folder,
        arguments.plan,
        arguments.robot,
        arguments.end_effector,
        "all" if show == ["all"] else show,
        speed=arguments.speed,
        camera=arguments.camera,
    )
    output = output_console()
    if arguments.record is not None:
        with shown_progress(Console(stderr=True)) as progress:
            scene.record(
                arguments.record,
                fps=arguments.fps,
                size=_size(arguments.size),
                browser=arguments.browser,
                progress=lambda share: progress("recording", share),
            )
        output.print(f"film: {arguments.record}", markup=False, highlight=False, soft_wrap=True)
        return 0
    out = folder / "view.html" if arguments.html is None else Path(arguments.html)
    scene.to_html(out)
    output.print(f"scene: {out}", markup=False, highlight=False, soft_wrap=True)
    if arguments.html is None and desktop():
        webbrowser.open(out.resolve().as_uri())
    return 0


def _size(text: str) -> tuple[int, int]:
    """Width and height of "800x600"."""
    from ffsms_pin.errors import InvalidValue

    width, _, height = text.lower().partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise InvalidValue("--size", text, "must be width and height in pixels, as 800x600")
    return int(width), int(height)


def desktop() -> bool:
    """Whether there is a display to open a window on."""
    return sys.platform in ("darwin", "win32") or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    )
