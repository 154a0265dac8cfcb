"""Arguments, commands and exit codes of `ffsms-pin`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import NoReturn

import ffsms_pin
from ffsms_pin.errors import FfsmsError

__all__ = ["main"]

# Exit codes.
REACHED, NOT_REACHED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130

_DESCRIPTION = """\
Plan and track motions of free-floating space manipulators, informed by dynamic coupling.

examples:
  ffsms-pin run case-2                     the paper's Case 2, into results/case-2
  ffsms-pin run mine.toml --out somewhere  a scenario of your own, into a folder of your choice
  ffsms-pin info planar_3r                 masses, limits and coupling of a packaged robot
  ffsms-pin info robot.urdf --end-effector tool0
"""
_EPILOG = """\
exit codes: 0 target reached; 1 target not reached, results written; 2 bad input; 130 interrupted
"""
_RUN = """\
Plan a scenario and track the plan in closed loop. Prints a summary table, and writes trajectory.npz,
tracking.npz, summary.json and the figures (pdf and png).

example: ffsms-pin run case-2 --out results/case-2
"""
_INFO = """\
Show a robot: masses, joint limits, how well conditioned its base inertia is, and its dynamic coupling.

example: ffsms-pin info planar_3r --joints-deg 1 1 1
"""


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"ffsms-pin: error: {message} (see {self.prog} --help)\n")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments; default: those of the process.
    """
    try:
        arguments = _parser().parse_args(argv)
    except SystemExit as stop:  # --help, --version, or arguments that cannot be used
        return int(stop.code or 0)
    try:
        # Imported only now: --help should not wait for what it does not need.
        if arguments.command == "run":
            from ffsms_pin.cli.run import run_command

            return (
                REACHED if run_command(arguments.scenario, arguments.out, arguments.figures) else NOT_REACHED
            )
        from ffsms_pin.cli.info import info_command

        info_command(arguments.model, arguments.end_effector, arguments.joints_deg)
    except FfsmsError as error:
        print(f"ffsms-pin: error: {error}", file=sys.stderr)  # noqa: T201
        return BAD_INPUT
    except KeyboardInterrupt:
        print("ffsms-pin: interrupted", file=sys.stderr)  # noqa: T201
        return INTERRUPTED
    return REACHED


def _parser() -> argparse.ArgumentParser:
    as_written = argparse.RawDescriptionHelpFormatter
    parser = _Parser(prog="ffsms-pin", description=_DESCRIPTION, epilog=_EPILOG, formatter_class=as_written)
    parser.add_argument("--version", action="version", version=f"ffsms-pin {ffsms_pin.__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=_Parser)

    run = commands.add_parser(
        "run", help="plan and track a scenario, write results", description=_RUN, formatter_class=as_written
    )
    run.add_argument("scenario", metavar="SCENARIO", help="case-1, case-2, or a scenario file (TOML)")
    run.add_argument("--out", metavar="DIR", help="folder for the results (default: results/SCENARIO)")
    run.add_argument(
        "--no-figures", dest="figures", action="store_false", help="write the numbers only, no figures"
    )

    info = commands.add_parser("info", help="show a robot", description=_INFO, formatter_class=as_written)
    info.add_argument("model", metavar="MODEL", help="a robot by name, as planar_3r, or a URDF file")
    info.add_argument(
        "--end-effector", metavar="FRAME", help="its frame (default: the last link's, where there is one)"
    )
    info.add_argument(
        "--joints-deg",
        metavar="ANGLE",
        nargs="+",
        type=float,
        help="posture for the coupling, one a joint (default: zero, or the middle of the limits"
        " where zero is outside)",
    )
    return parser
