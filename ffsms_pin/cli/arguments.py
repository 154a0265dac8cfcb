"""What a command consists of, and arguments that several commands take."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace, _ArgumentGroup
from collections.abc import Callable
from typing import Any, NamedTuple

__all__ = ["PACKAGED_OR_FILE", "Command", "add_robot", "add_scenario", "add_work", "work_arguments"]

PACKAGED_OR_FILE = "a packaged one, as case-2, or a scenario file (TOML)"


class Command(NamedTuple):
    """One command of `ffsms-pin`; its module is imported when it runs: --help should not wait for it."""

    function: str  # "module:name" below ffsms_pin.cli: it takes the arguments and returns the exit code
    help: str
    description: str
    add_arguments: Callable[[ArgumentParser], None]
    exits: str = "0 done; 2 bad input"
    resumes: bool = False  # whether the same command goes on where it was stopped


def add_scenario(parser: ArgumentParser, results: str, words: str = "") -> None:
    """Add the scenario, where `words` say what it may be, --out and --allow-import."""
    if words:
        parser.add_argument("scenario", metavar="SCENARIO", help=words)
    parser.add_argument(
        "--out", metavar="DIR", help=f"folder for the results (default: results/SCENARIO{results})"
    )
    parser.add_argument(
        "--allow-import",
        action="store_true",
        help="let the scenario import terms and limits from Python modules; this runs their code",
    )


def add_robot(parser: ArgumentParser) -> None:
    """Add the robot, and the frame that is its end effector."""
    parser.add_argument("model", metavar="MODEL", help="a robot by name, as planar_3r, or a URDF file")
    parser.add_argument(
        "--end-effector", metavar="FRAME", help="its frame (default: the last link's, where there is one)"
    )


def add_work(parser: ArgumentParser | _ArgumentGroup) -> None:
    """Add --jobs, --scheduler and --shard, for work that is done in chunks."""
    parser.add_argument("--jobs", type=int, metavar="N", help="processes at once (default: one a core)")
    parser.add_argument(
        "--scheduler", metavar="ADDRESS", help="a Dask scheduler that stands, as tcp://host:8786"
    )
    parser.add_argument(
        "--shard",
        metavar="I/N",
        help="do every N-th chunk from the I-th on, in this process; the command without it does the rest",
    )


def work_arguments(arguments: Namespace) -> dict[str, Any]:
    """They as keyword arguments of `ffsms_pin.engine.run`."""
    from ffsms_pin.engine import Shard

    shard = None if arguments.shard is None else Shard.read(arguments.shard)
    return {"jobs": arguments.jobs, "scheduler": arguments.scheduler, "shard": shard}
