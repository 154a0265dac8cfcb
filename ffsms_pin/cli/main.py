"""The entry point, arguments, errors, signals and exit codes of `ffsms-pin`."""

from __future__ import annotations

import argparse
import os
import signal
import sys
import textwrap
import traceback
import warnings
from collections.abc import Container, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from inspect import cleandoc
from typing import Any, NoReturn, TypeAlias

from ffsms_pin.errors import FfsmsError, FfsmsWarning, InvalidValue, advised, meant
from ffsms_pin.version import __version__

BAD_INPUT = 2  # exit code for wrong arguments or files
Commands: TypeAlias = "argparse._SubParsersAction[_Parser]"

_DESCRIPTION = """\
Plan and track motions of free-floating space manipulators, informed by dynamic coupling.

examples:
  ffsms-pin run case-2                        a packaged scenario, into results/case-2
  ffsms-pin scenario --print case-2           a packaged scenario file, to start from
  ffsms-pin run mine.toml --out somewhere     a scenario of your own, into a folder of your choice
  ffsms-pin view results/case-2               the motion in the browser, as one HTML file
  ffsms-pin info planar_3r                    masses, limits and coupling of a packaged robot
  ffsms-pin info mine.urdf --repair new.urdf  faults of a file, and a copy that loads

ffsms-pin COMMAND --help has examples of each command.
"""
_PACKAGED = "case-1, case-2, paper-case-1, paper-case-2, wrong-model, inspect, capture, nozzle"
_SCENARIO = "a packaged scenario such as case-2, or a scenario file (TOML)"
_ROBOT = (
    "a URDF or MJCF file, or a robot by name: planar_3r, servicer, space_arm_7, two_arms, satellite_kinova, "
    "satellite_panda, satellite_ur5, satellite_ur10, satellite_xarm7, satellite_z1"
)


def parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    exits = "0 target reached; 1 target not reached, results written; 2 bad input"
    whole = _Parser(
        prog="ffsms-pin",
        description=_DESCRIPTION,
        epilog=_exit_codes(exits),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    whole.add_argument("--version", action="version", version=f"ffsms-pin {__version__}")
    commands = whole.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=_Parser)
    for add in (_add_run, _add_compare, _add_campaign, _add_scenario, _add_info, _add_view, _add_export):
        add(commands)
    return whole


def command_names() -> list[str]:
    """Return the names of all commands, in the order of --help."""
    (commands,) = (action.choices for action in parser()._actions if action.dest == "command")
    return list(commands or ())


def named(arguments: argparse.Namespace, *names: str) -> dict[str, Any]:
    """Return the named arguments that are not None, as keyword arguments."""
    return {name: value for name in names if (value := getattr(arguments, name)) is not None}


# Advice to Python users in the library's errors, and the same advice for the command line.
_IN_COMMANDS = {
    "allow_import=True": "--allow-import",
    "allow_outside=True": "--allow-outside",
    "package_dirs=[FOLDER]": "[robot] package_dirs of a scenario file",
    "ffsms_pin.inspection.repair(path, out)": "`ffsms-pin info FILE --repair OUT`",
    "ffsms_pin.campaigns.campaign": "`ffsms-pin campaign`",
}


def in_options(message: str, known: Container[str] = ()) -> str:
    """Return a message of the library with its Python arguments replaced by command-line options.

    If an argument of `load` is not among the `known` options, advice on it becomes advice to repair the file.
    """
    for python, command in _IN_COMMANDS.items():
        message = message.replace(python, command)
    message = advised(message, "--{option} {value}", known)
    return advised(message, "the file that `ffsms-pin info FILE --repair OUT` writes")


def _add_run(commands: Commands) -> None:
    run = _command(
        commands,
        "run",
        """Plan and track a scenario, and write the results.

        Plan a scenario and follow it in closed loop under the conditions that it sets: a plant that differs
        from the model, re-planning in the loop, friction, sensors, disturbances, failures (all keys: page
        "Keys of scenario files" of the documentation, docs/scenario-keys.md). Print a summary table, and
        write trajectory.npz, tracking.npz, scenario.json, summary.json and the figures (pdf and png). For a
        capture, also write capture.npz and the animated scene capture.html.

        paper-case-1 and paper-case-2 use the paper's step-by-step method ("paper"); case-1 and case-2 plan
        the whole motion at once (method "horizon").

        example: ffsms-pin run case-2 --out results/case-2
        To repeat one run of a campaign by its seed: ffsms-pin run --replay results/mine-campaign 4711
        """,
        "0 plan and closed loop reach the target, or the client is caught within all limits; 1 otherwise, "
        "results written; "
        "2 bad input, or a state that is not finite",
    )
    what = run.add_mutually_exclusive_group(required=True)
    what.add_argument(
        "scenario", metavar="SCENARIO", nargs="?", help=f"{_PACKAGED}, or a scenario file (TOML)"
    )
    what.add_argument(
        "--replay", metavar=("DIR", "SEED"), nargs=2, help="one run of the campaign in a folder, by its seed"
    )
    _add_out(run, "results/SCENARIO")
    run.add_argument("--no-figures", action="store_true", help="write no figures")
    run.add_argument("--show", action="store_true", help="open the animated scene, if there is a display")
    run.add_argument(
        "--allow-outside",
        action="store_true",
        help="allow files of the scenario ([guards] path) outside the results folder",
    )


def _add_compare(commands: Commands) -> None:
    compare = _command(
        commands,
        "compare",
        """Plan a scenario by every method, side by side.

        Print a table, and write comparison.json and a figure (pdf and png).

        example: ffsms-pin compare case-2
        """,
    )
    compare.add_argument("scenario", metavar="SCENARIO", help=_SCENARIO)
    _add_out(compare, "results/SCENARIO-comparison")
    compare.add_argument(
        "--methods",
        metavar="METHOD",
        nargs="+",
        help="methods among horizon, step, paper, resolved-rate, least-disturbance, minimum-effort "
        "(default: all that can plan the scenario)",
    )


def _add_campaign(commands: Commands) -> None:
    campaign = _command(
        commands,
        "campaign",
        """Run a scenario many times with drawn plants, targets, noise and faults.

        Each run is a closed loop with values drawn from the distributions in the scenario's table
        [campaign.draw] (docs/campaigns.md). Write one row per run (two with --compare) to DIR/runs.csv, a
        report (report.json) and a figure (pdf and png). If the command was interrupted, run it again to
        continue. The table does not depend on interruptions or on the number of processes.

        For example:
          ffsms-pin campaign mine.toml --runs 10000 --out mine          one process per core
          ffsms-pin campaign mine.toml --runs 10000 --out mine --scheduler tcp://head:8786
          ffsms-pin campaign mine --runs 20000                          extend it to 20000 runs
          ffsms-pin campaign case-1 --runs 50 --compare                 each run planned once and re-planned
          ffsms-pin run --replay mine 4711                              repeat one of its runs, by its seed
        """,
        "0 all runs done, whether they arrived or not; 2 bad input, or no workers",
    )
    campaign.add_argument(
        "scenario",
        metavar="SCENARIO",
        help="a packaged scenario, a scenario file (TOML) with [campaign.draw], or the folder of a campaign",
    )
    _add_out(campaign, "results/SCENARIO-campaign")
    campaign.add_argument(
        "--runs", metavar="N", type=int, help="number of runs; optional with the folder of a campaign"
    )
    campaign.add_argument(
        "--seed", metavar="N", type=int, help="seed of the first run (default: the file's, or 1)"
    )
    campaign.add_argument(
        "--compare", action="store_true", help="run each drawn scenario twice: planned once and re-planned"
    )
    where = campaign.add_mutually_exclusive_group()
    where.add_argument(
        "--jobs",
        metavar="N",
        type=int,
        help="number of processes; 1 needs no Dask (default: one per core; 1 without Dask)",
    )
    where.add_argument(
        "--scheduler", metavar="ADDRESS", help="a running Dask scheduler, such as tcp://host:8786"
    )


def _add_scenario(commands: Commands) -> None:
    scenario = _command(
        commands,
        "scenario",
        """Print a packaged scenario file, or the JSON Schema of scenario files.

        Use the file as a start for your own scenario. With the schema, editors complete keys and show units.

        For example:
          ffsms-pin scenario --print case-2 > mine.toml
          ffsms-pin scenario --schema > scenario.schema.json

        Editors that read schemas of TOML (Even Better TOML, Taplo) use it if this is the file's first line:
          #:schema ./scenario.schema.json
        """,
    )
    what = scenario.add_mutually_exclusive_group(required=True)
    what.add_argument(
        "--print", dest="name", metavar="NAME", help=f"name of a packaged scenario: {_PACKAGED}"
    )
    what.add_argument("--schema", action="store_true", help="print the JSON Schema")


def _add_info(commands: Commands) -> None:
    info = _command(
        commands,
        "info",
        """Show a robot and the faults of its file.

        Print masses, joint limits, joint friction, the condition of the base inertia and the dynamic
        coupling. Faults of a URDF file come first, each with its repair. If the file does not load, its links
        and joints are listed. With --repair, write a file that loads, list every change, and show that robot;
        if a fault that prevents loading needs a value that only the author has, nothing is written.

        For example:
          ffsms-pin info planar_3r --joints-deg 1 1 1
          ffsms-pin info robot.urdf --repair repaired.urdf
        """,
        "0 the robot, or the repaired file, loads; 1 the file does not load; 2 bad input, or a file that "
        "cannot be repaired",
    )
    _add_robot(info)
    info.add_argument(
        "--joints-deg",
        metavar="ANGLE",
        type=float,
        nargs="+",
        help="posture for the coupling, one angle [deg] per joint (default: zero; if zero is outside "
        "the limits, their middle, or the finite limit)",
    )
    info.add_argument("--repair", metavar="OUT", help="write a URDF that loads, and list the changes")
    info.add_argument(
        "--rate",
        metavar="LIMIT",
        type=float,
        help="rate limit for joints without one, with --repair [rad/s or m/s] (default: 0.5)",
    )
    info.add_argument(
        "--effort",
        metavar="LIMIT",
        type=float,
        help="torque or force limit for joints without one, with --repair [N m or N] (default: 100)",
    )


def _add_view(commands: Commands) -> None:
    view = _command(
        commands,
        "view",
        """Animate results in the browser, as one HTML file.

        Show the results of `ffsms-pin run`: the satellite and its arm in motion with the coupling, obstacles,
        client, wheels and thrusters. Write one self-contained HTML file, which needs no network; without
        --html it is view.html in the results.

        For example:
          ffsms-pin view results/case-2                        write results/case-2/view.html, and open it
          ffsms-pin view results/case-2 --html out.html        write the file only
          ffsms-pin view results/capture --speed 2 --camera side
          ffsms-pin view results/case-2 --robot mine.urdf      results of a robot from a file
        """,
    )
    view.add_argument("results", metavar="RESULTS", help="results folder of `ffsms-pin run`")
    view.add_argument("--html", metavar="FILE", help="write this file, and do not open it")
    view.add_argument("--plan", action="store_true", help="show the plan, not the simulated motion")
    view.add_argument(
        "--robot",
        metavar="ROBOT",
        help="the robot of the results, or their scenario file; needed if the results do not name the robot",
    )
    view.add_argument("--end-effector", metavar="FRAME", help="end-effector frame of the robot in --robot")
    view.add_argument(
        "--speed",
        metavar="FACTOR",
        type=float,
        default=1.0,
        help="playback speed; 2 is twice real time (default: 1)",
    )
    view.add_argument(
        "--camera",
        metavar="VIEW",
        default="free",
        help="first view: free, front (from +x), side (from -y), top, or base, which moves with the base "
        "(default: free)",
    )
    view.add_argument("--background", metavar="COLOUR", default="dark", help="dark or white (default: dark)")
    view.add_argument(
        "--show",
        metavar="LAYERS",
        help="layers visible at first: 'all', or names separated by commas, such as robot,target,limits (an "
        "unknown name prints all names)",
    )


def _add_export(commands: Commands) -> None:
    export = _command(
        commands,
        "export",
        """Export a robot for other tools.

        Write the whole robot, satellite included, as a URDF or as a MuJoCo model with names, masses, joint
        limits and shapes. Meshes of a URDF are copied into FILE_meshes beside it; a MuJoCo model contains its
        meshes.

        For example:
          ffsms-pin export satellite_panda --urdf panda.urdf
          ffsms-pin export mine.toml --mjcf mine.xml         the robot of a scenario, with its mount
        """,
    )
    _add_robot(export, "; or a scenario (TOML)")
    form = export.add_mutually_exclusive_group(required=True)
    form.add_argument("--urdf", metavar="FILE", help="write a URDF")
    form.add_argument(
        "--mjcf", metavar="FILE", help="write a MuJoCo model: a free base, no gravity, one motor per joint"
    )


def _command(
    commands: Commands, name: str, description: str, exits: str = "0 done; 2 bad input"
) -> argparse.ArgumentParser:
    """Add a command whose help begins with a summary in one line, and return its parser."""
    description = cleandoc(description)
    summary = description.partition("\n")[0].rstrip(".")
    return commands.add_parser(
        name,
        help=summary[0].lower() + summary[1:],
        description=description,
        epilog=_exit_codes(exits),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def _exit_codes(own: str) -> str:
    """Return a text with a command's own exit codes and those of all commands."""
    common = (
        "70 a defect of ffsms-pin (FFSMS_PIN_TRACEBACK=1 prints the traceback); 130 interrupted; 141 the "
        "output pipe was closed, for example by head; 143 terminated"
    )
    return textwrap.fill(f"exit codes: {own}; {common}", 100)


def _add_out(command: argparse.ArgumentParser, default: str) -> None:
    """Add --out and --allow-import."""
    command.add_argument("--out", metavar="DIR", help=f"folder for the results (default: {default})")
    command.add_argument(
        "--allow-import",
        action="store_true",
        help="allow the scenario to import terms and limits from Python modules, which runs their code",
    )


def _add_robot(command: argparse.ArgumentParser, more: str = "") -> None:
    """Add the robot and its end-effector frame."""
    command.add_argument("model", metavar="MODEL", help=_ROBOT + more)
    command.add_argument(
        "--end-effector",
        metavar="FRAME",
        help="end-effector frame (default: the tool frame of known robots, else the frame of the last link; "
        "needed if the arm has several ends)",
    )


class _Parser(argparse.ArgumentParser):
    """A parser that prints errors in one line and proposes the most similar option."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse the arguments; reject unknown options first.

        Otherwise argparse would report a misspelt required option as missing.
        """
        known = list(self._option_string_actions)
        for argument in args if self._subparsers is None else ():
            option = argument.partition("=")[0]
            if option.startswith("--") and not any(name.startswith(option) for name in known):
                self.error(f"unknown argument '{argument}'{meant(option, known, '; ')}")
        parsed, rest = super().parse_known_args(args, namespace)
        if rest:
            self.error(f"unknown argument '{rest[0]}'")
        return parsed, rest

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"ffsms-pin: error: {message} (see {self.prog} --help)\n")


# Exit codes of all commands; each command defines its own 0 and 1.
DEFECT, BROKEN_PIPE, INTERRUPTED, TERMINATED = 70, 141, 130, 143


class _Terminated(KeyboardInterrupt):
    """The exception raised on SIGTERM; the clean-up is the same as after Ctrl-C."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line on arguments, by default those of the process, and return the exit code."""
    typed = sys.argv[1:] if argv is None else list(argv)
    if problem := _command_problem(typed):
        return _failed(f"error: {problem} (see ffsms-pin --help)", BAD_INPUT)
    try:
        arguments = parser().parse_args(typed)
    except SystemExit as stop:  # --help, --version, or invalid arguments
        return int(stop.code or 0)
    try:
        with _ended_by_sigterm(), _plain_warnings():
            # The command's module is imported here so that --help does not wait for the solvers.
            status = int(import_module(f"ffsms_pin.cli.{arguments.command}").run(arguments))
            sys.stdout.flush()
            return status
    except BrokenPipeError:  # the reading process, for example `head`, has ended
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # discard writes at exit
        return BROKEN_PIPE
    except FfsmsError as error:
        message = in_options(str(error), vars(arguments))
        if isinstance(error, InvalidValue):
            option = "--" + error.name.partition("[")[0].replace("_", "-")
            if option in (word.partition("=")[0] for word in typed):
                message = option + message.removeprefix(error.name)
        return _failed(f"error: {message}", BAD_INPUT)
    except KeyboardInterrupt as stop:
        terminated = isinstance(stop, _Terminated)
        message, status = ("terminated", TERMINATED) if terminated else ("interrupted", INTERRUPTED)
        if arguments.command == "campaign":
            message += "; finished chunks of runs are kept: run the same command again to continue"
        return _failed(message, status)
    except MemoryError:
        return _failed("error: out of memory; use shorter motions or fewer runs", BAD_INPUT)
    except Exception as error:  # a defect of ffsms-pin
        if os.environ.get("FFSMS_PIN_TRACEBACK"):
            traceback.print_exc()
        what = " ".join(f"{type(error).__name__}: {error}".split())
        return _failed(f"a defect of ffsms-pin, please report it: {what}", DEFECT)


@contextmanager
def _plain_warnings() -> Iterator[None]:
    """Print each warning of the library in one line, without the source line that Python adds."""
    usual = warnings.formatwarning

    def formatted(message: Warning | str, category: type[Warning], *place: Any, **line: Any) -> str:
        if issubclass(category, FfsmsWarning):
            return f"ffsms-pin: warning: {in_options(str(message))}\n"
        return usual(message, category, *place, **line)

    warnings.formatwarning = formatted
    try:
        yield
    finally:
        warnings.formatwarning = usual


def _command_problem(typed: Sequence[str]) -> str:
    """Return an error message if the command is missing or unknown; empty otherwise."""
    if not typed:
        return "name a command, for example: ffsms-pin run case-2"
    names = command_names()
    if typed[0].startswith("-") or typed[0] in names:
        return ""
    remedy = meant(typed[0], names) or f"the commands are {', '.join(names)}"
    return f"there is no command '{typed[0]}'; {remedy}"


def _failed(message: str, code: int) -> int:
    print(f"ffsms-pin: {message}", file=sys.stderr)  # noqa: T201
    return code


@contextmanager
def _ended_by_sigterm() -> Iterator[None]:
    """Make SIGTERM end the block like Ctrl-C, in the main thread and if SIGTERM has its default action."""

    def terminate(*_: object) -> NoReturn:
        raise _Terminated

    try:
        usual = signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
        if usual:
            signal.signal(signal.SIGTERM, terminate)
    except ValueError:  # only the main thread may set handlers
        usual = False
    try:
        yield
    finally:
        if usual:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
