"""`ffsms-pin run`: its arguments."""

from __future__ import annotations

import argparse
from typing import Any

from ffsms_pin.cli.allow_import import add_allow_import

__all__ = ["add_parser", "run"]

REACHED, NOT_REACHED = 0, 1

_DESCRIPTION = """\
Plan a scenario and follow it in closed loop, under whatever conditions it sets: a plant that is not the
model, planning again in the loop, friction, sensors, disturbances, failures (docs/scenarios.md lists all
keys). Prints a summary table, and writes trajectory.npz, tracking.npz, scenario.json, summary.json and the
figures (pdf and png).

example: ffsms-pin run case-2 --out results/case-2
One run of a campaign, by its seed: ffsms-pin run --replay results/mine-campaign 4711

exit codes: 0 the plan reaches the target and the closed loop ends there; 1 one of them does not, results
written; 2 bad input, or the run was stopped; 70 a defect of ffsms-pin; 130 interrupted; 143 terminated
"""


def add_parser(subparsers: Any) -> None:
    """Add `run` to the commands (argparse's subparsers)."""
    parser = subparsers.add_parser(
        "run",
        help="plan and track a scenario, write results",
        description=_DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument(
        "scenario",
        metavar="SCENARIO",
        nargs="?",
        help="case-1, case-2, wrong-model, capture, or a scenario file (TOML)",
    )
    what.add_argument(
        "--replay", metavar=("DIR", "SEED"), nargs=2, help="one run of the campaign in a folder, by its seed"
    )
    parser.add_argument("--out", metavar="DIR", help="folder for the results (default: results/SCENARIO)")
    parser.add_argument(
        "--no-figures", dest="figures", action="store_false", help="write the numbers only, no figures"
    )
    parser.add_argument(
        "--show", action="store_true", help="open the animated scene, where there is a display"
    )
    parser.add_argument(
        "--allow-outside",
        action="store_true",
        help="let files that the scenario names (stream, watchdog path) lie outside the results folder",
    )
    add_allow_import(parser)


def run(arguments: argparse.Namespace) -> int:
    """Run the scenario; returns the exit code."""
    from ffsms_pin.cli.run import replayed, run_scenario

    chosen = arguments.scenario
    if arguments.replay is not None:
        folder, seed = arguments.replay
        chosen = replayed(folder, seed, arguments.allow_import)
    reached = run_scenario(
        chosen,
        arguments.out,
        arguments.figures,
        arguments.show,
        arguments.allow_outside,
        arguments.allow_import,
    )
    return REACHED if reached else NOT_REACHED
