"""Arguments, commands and exit codes of `ffsms-pin`."""

from __future__ import annotations

import argparse
import importlib
import os
import signal
import sys
import textwrap
import traceback
from collections.abc import Callable, Container, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from inspect import cleandoc
from typing import Any, NamedTuple, NoReturn, TypeAlias

import ffsms_pin
from ffsms_pin.errors import FfsmsError, InvalidValue, advised, meant

PACKAGED_OR_FILE = "a packaged one, as case-2, or a scenario file (TOML)"

# Exit codes; 0 and 1 are the commands' own.
BAD_INPUT, DEFECT, INTERRUPTED, TERMINATED = 2, 70, 130, 143

_DESCRIPTION = """\
Plan and track motions of free-floating space manipulators, informed by dynamic coupling.

examples:
  ffsms-pin run case-2                     the paper's Case 2, into results/case-2
  ffsms-pin scenario --print case-2        a packaged scenario file, to begin with
  ffsms-pin run mine.toml --out somewhere  a scenario of your own, into a folder of your choice
  ffsms-pin view results/case-2            the motion in the browser, as one HTML file
  ffsms-pin info planar_3r                 masses, limits and coupling of a packaged robot
  ffsms-pin info mine.urdf --repair new.urdf  faults of a file, and a copy that loads

ffsms-pin COMMAND --help has examples of each command.
"""
_EXITS = "0 target reached; 1 target not reached, results written; 2 bad input or a run that was stopped"


Arguments: TypeAlias = argparse.ArgumentParser | argparse._ArgumentGroup


class Command(NamedTuple):
    """One command of `ffsms-pin`; its module is imported when it runs: --help should not wait for it."""

    function: str  # "module:name" below ffsms_pin.cli: it takes the arguments and returns the exit code
    help: str
    description: str
    add_arguments: Callable[[argparse.ArgumentParser], None]
    exits: str
    resumes: bool  # whether the same command goes on where it was stopped


def command(
    function: str, exits: str = "0 done; 2 bad input", resumes: bool = False
) -> Callable[[Callable[[argparse.ArgumentParser], None]], Command]:
    """Make a command of what adds its arguments, whose docstring is what --help says of it."""

    def made(add_arguments: Callable[[argparse.ArgumentParser], None]) -> Command:
        description = cleandoc(add_arguments.__doc__ or "")
        summary = description.partition("\n")[0].rstrip(".")
        words = summary[:1].lower() + summary[1:]
        return Command(function, words, description, add_arguments, exits, resumes)

    return made


def option(
    parser: Arguments,
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


def flag(parser: Arguments, name: str, what: str) -> None:
    """Add an option without a value."""
    parser.add_argument(name, action="store_true", help=what)


def add_scenario(parser: argparse.ArgumentParser, results: str, words: str = "") -> None:
    """Add the scenario, where `words` say what it may be, --out and --allow-import."""
    if words:
        parser.add_argument("scenario", metavar="SCENARIO", help=words)
    option(parser, "--out", "DIR", "folder for the results", shown=f"results/SCENARIO{results}")
    words = "let the scenario import terms and limits from Python modules; this runs their code"
    flag(parser, "--allow-import", words)


def add_robot(parser: argparse.ArgumentParser) -> None:
    """Add the robot, and the frame that is its end effector."""
    words = (
        "a URDF file, or a robot by name: planar_3r, servicer, space_arm_7, two_arms, satellite_kinova, "
        "satellite_panda, satellite_ur5, satellite_ur10, satellite_xarm7, satellite_z1"
    )
    parser.add_argument("model", metavar="MODEL", help=words)
    option(parser, "--end-effector", "FRAME", "its frame", shown="the last link's, where there is one")


@cache
def commands() -> dict[str, Command]:
    """All commands by their names, in the order of --help."""
    from ffsms_pin.cli import robot_commands, scenario_commands  # which take what is above

    return {
        name.replace("_", "-"): one
        for module in (scenario_commands, robot_commands)
        for name, one in vars(module).items()
        if isinstance(one, Command)
    }


class _Terminated(KeyboardInterrupt):
    """SIGTERM came: everything that cleans up after Ctrl-C does so now."""


class _Parser(argparse.ArgumentParser):
    """Errors in one line, with a guess at what was meant."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As argparse has it, but a command says itself, and first, what it does not know."""
        known = list(self._option_string_actions)
        for given in args if self._subparsers is None else ():
            option = given.partition("=")[0]
            if option.startswith("--") and not any(one.startswith(option) for one in known):
                self.error(f"unknown argument '{given}'{meant(option, known, '; ')}")
        found, rest = super().parse_known_args(args, namespace)
        if rest:
            self.error(f"unknown argument '{rest[0]}'")
        return found, rest

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"ffsms-pin: error: {message} (see {self.prog} --help)\n")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line on arguments, by default those of the process; returns the exit code."""
    given = sys.argv[1:] if argv is None else list(argv)
    if words := _no_command(given):
        return _failed(f"error: {words} (see ffsms-pin --help)", BAD_INPUT)
    try:
        arguments = parser(given[0]).parse_args(given)
    except SystemExit as stop:  # --help, --version, or arguments that cannot be used
        return int(stop.code or 0)
    try:
        with _ended_by_sigterm():
            module, _, name = commands()[arguments.command].function.partition(":")
            command = getattr(importlib.import_module(f"ffsms_pin.cli.{module}"), name)
            status = int(command(arguments))
            sys.stdout.flush()
            return status
    except BrokenPipeError:  # whoever read has seen enough, as `head` has
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for what is written at exit
        return 141  # of shells, for SIGPIPE
    except FfsmsError as error:
        words = in_options(str(error), vars(arguments))
        if isinstance(error, InvalidValue):
            argument = error.name.partition("[")[0]
            option = "--" + argument.replace("_", "-")
            if option in (one.partition("=")[0] for one in given):
                words = option + words.removeprefix(error.name)
        return _failed(f"error: {words}", BAD_INPUT)
    except KeyboardInterrupt as stop:
        asked = isinstance(stop, _Terminated)
        words, status = ("terminated", TERMINATED) if asked else ("interrupted", INTERRUPTED)
        if commands()[arguments.command].resumes:
            words += "; what is done is kept: the same command goes on from there"
        return _failed(words, status)
    except MemoryError:
        return _failed("error: out of memory; ask for shorter motions or fewer of them", BAD_INPUT)
    except Exception as error:  # whatever is left is our fault
        if os.environ.get("FFSMS_PIN_TRACEBACK"):
            traceback.print_exc()
        what = " ".join(f"{type(error).__name__}: {error}".split())
        return _failed(f"a defect of ffsms-pin, please report it: {what}", DEFECT)


def _no_command(given: Sequence[str]) -> str:
    """What is wrong with the command that comes first, in words; empty where nothing is."""
    if not given:
        return "name a command, as: ffsms-pin run case-2"
    if given[0].startswith("-") or given[0] in commands():
        return ""
    guess = meant(given[0], commands()) or f"there are {', '.join(commands())}"
    return f"there is no command '{given[0]}'; {guess}"


def _failed(words: str, code: int) -> int:
    print(f"ffsms-pin: {words}", file=sys.stderr)  # noqa: T201
    return code


@contextmanager
def _ended_by_sigterm() -> Iterator[None]:
    """Let SIGTERM end the block as Ctrl-C does, where nobody else has a use for the signal."""

    def terminate(*_: object) -> NoReturn:
        raise _Terminated

    try:
        usual = signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
        if usual:
            signal.signal(signal.SIGTERM, terminate)
    except ValueError:  # only the main thread may ask for signals
        usual = False
    try:
        yield
    finally:
        if usual:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)


def parser(only: str | None = None) -> argparse.ArgumentParser:
    """The parser of all commands; where `only` is one, it knows the arguments of that one alone."""
    raw = argparse.RawDescriptionHelpFormatter
    whole = _Parser(prog="ffsms-pin", description=_DESCRIPTION, epilog=_exits(_EXITS), formatter_class=raw)
    whole.add_argument("--version", action="version", version=f"ffsms-pin {ffsms_pin.__version__}")
    every = whole.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=_Parser)
    for name, command in commands().items():
        more: Any = {"description": command.description, "epilog": _exits(command.exits)}
        one = every.add_parser(name, help=command.help, formatter_class=raw, **more)
        if only in (name, None):
            command.add_arguments(one)
    return whole


def _exits(own: str) -> str:
    """The exit codes of a command in words: its own, and those of all."""
    of_all = (
        "70 a defect of ffsms-pin (with FFSMS_PIN_TRACEBACK=1 it says where); 130 interrupted; 143 terminated"
    )
    return textwrap.fill(f"exit codes: {own}; {of_all}", 100)


def in_options(words: str, known: Container[str] = ()) -> str:
    """Words of an error with their advice for Python as an option of the command, where it has that one.

    Advice about other arguments of `load` becomes advice to repair the file.
    """
    words = advised(words, "--{option} {value}", known)
    return advised(words, "the file that `ffsms-pin info FILE --repair OUT` writes")


def named(arguments: argparse.Namespace, *names: str) -> dict[str, Any]:
    """Some of the arguments as keyword arguments of the same names, without those that were left out."""
    return {name: value for name in names if (value := getattr(arguments, name)) is not None}
