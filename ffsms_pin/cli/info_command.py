"""`ffsms-pin info`: its arguments."""

from __future__ import annotations

import argparse
from typing import Any

__all__ = ["add_parser", "run"]

_DESCRIPTION = """\
Show a robot: masses, joint limits, how well conditioned its base inertia is, and its dynamic coupling.

example: ffsms-pin info planar_3r --joints-deg 1 1 1
"""


def add_parser(subparsers: Any) -> None:
    """Add `info` to the commands (argparse's subparsers)."""
    parser = subparsers.add_parser(
        "info",
        help="show a robot",
        description=_DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("model", metavar="MODEL", help="a robot by name, as planar_3r, or a URDF file")
    parser.add_argument(
        "--end-effector", metavar="FRAME", help="its frame (default: the last link's, where there is one)"
    )
    parser.add_argument(
        "--joints-deg",
        metavar="ANGLE",
        nargs="+",
        type=float,
        help="posture for the coupling, one a joint (default: zero, or the middle of the limits"
        " where zero is outside)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Print what is known about the robot; returns the exit code."""
    from ffsms_pin.cli.info import show_robot

    show_robot(arguments.model, arguments.end_effector, arguments.joints_deg)
    return 0
