"""What a command consists of, and arguments that several commands take."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace, _ArgumentGroup
from collections.abc import Callable, Container
from inspect import cleandoc
from typing import Any, NamedTuple

from ffsms_pin.errors import advised

PACKAGED_OR_FILE = "a packaged one, as case-2, or a scenario file (TOML)"


class Command(NamedTuple):
    """One command of `ffsms-pin`; its module is imported when it runs: --help should not wait for it."""

    function: str  # "module:name" below ffsms_pin.cli: it takes the arguments and returns the exit code
    help: str
    description: str
    add_arguments: Callable[[ArgumentParser], None]
    exits: str
    resumes: bool  # whether the same command goes on where it was stopped


def command(
    function: str, exits: str = "0 done; 2 bad input", resumes: bool = False
) -> Callable[[Callable[[ArgumentParser], None]], Command]:
    """Make a command of what adds its arguments, whose docstring is what --help says of it."""

    def made(add_arguments: Callable[[ArgumentParser], None]) -> Command:
        description = cleandoc(add_arguments.__doc__ or "")
        summary = description.partition("\n")[0].rstrip(".")
        words = summary[:1].lower() + summary[1:]
        return Command(function, words, description, add_arguments, exits, resumes)

    return made


def option(
    parser: ArgumentParser | _ArgumentGroup,
    name: str,
    metavar: str | None,
    what: str,
    default: Any = None,
    *,
    shown: str = "",
    kind: type = str,
    **others: Any,
) -> None:
    """Add an option with a value; its help ends with the default, or what is `shown` for it.

    Its `kind` is that of the default, where there is one.
    """
    if default is not None:
        shown, kind = f"{default:g}" if isinstance(default, float) else str(default), type(default)
    words = f"{what} (default: {shown})" if shown else what
    parser.add_argument(name, metavar=metavar, type=kind, default=default, help=words, **others)


def flag(parser: ArgumentParser | _ArgumentGroup, name: str, what: str) -> None:
    """Add an option without a value."""
    parser.add_argument(name, action="store_true", help=what)


def add_scenario(parser: ArgumentParser, results: str, words: str = "") -> None:
    """Add the scenario, where `words` say what it may be, --out and --allow-import."""
    if words:
        parser.add_argument("scenario", metavar="SCENARIO", help=words)
    option(parser, "--out", "DIR", "folder for the results", shown=f"results/SCENARIO{results}")
    words = "let the scenario import terms and limits from Python modules; this runs their code"
    flag(parser, "--allow-import", words)


def add_robot(parser: ArgumentParser) -> None:
    """Add the robot, and the frame that is its end effector."""
    words = (
        "a URDF file, or a robot by name: planar_3r, servicer, space_arm_7, two_arms, satellite_kinova, "
        "satellite_panda, satellite_ur5, satellite_ur10, satellite_xarm7, satellite_z1"
    )
    parser.add_argument("model", metavar="MODEL", help=words)
    option(parser, "--end-effector", "FRAME", "its frame", shown="the last link's, where there is one")


def add_jobs(parser: ArgumentParser | _ArgumentGroup) -> None:
    """Add --jobs."""
    option(parser, "--jobs", "N", "processes at once", shown="one a core", kind=int)


def add_work(parser: ArgumentParser | _ArgumentGroup) -> None:
    """Add --jobs, --scheduler and --shard, for work that is done in chunks."""
    add_jobs(parser)
    option(parser, "--scheduler", "ADDRESS", "a Dask scheduler that stands, as tcp://host:8786")
    words = "do every N-th chunk from the I-th on, in this process; the command without it does the rest"
    option(parser, "--shard", "I/N", words)


def in_options(words: str, known: Container[str] = ()) -> str:
    """Words of an error with their advice for Python as an option of the command, where it has that one.

    Else with what mends the file.
    """
    words = advised(words, "--{option} {value}", known)
    return advised(words, "the file that `ffsms-pin inspect FILE --repair OUT` writes")


def work_arguments(arguments: Namespace) -> dict[str, Any]:
    """They as keyword arguments of `ffsms_pin.engine.run`."""
    from ffsms_pin.engine import Shard

    shard = None if arguments.shard is None else Shard.read(arguments.shard)
    return {"jobs": arguments.jobs, "scheduler": arguments.scheduler, "shard": shard}
