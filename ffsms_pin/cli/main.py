"""Arguments, commands and exit codes of `ffsms-pin`."""

from __future__ import annotations

import argparse
import importlib
import os
import signal
import sys
import textwrap
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NoReturn

import ffsms_pin
from ffsms_pin.cli import robot_commands, scenario_commands
from ffsms_pin.cli.arguments import Command, in_options
from ffsms_pin.errors import FfsmsError, InvalidValue, meant

# Options whose names are not those of the arguments that they become.
_OPTIONS = {"parameters": "vary", "directions": "direction"}
# Exit codes; 0 and 1 are the commands' own.
BAD_INPUT, DEFECT, INTERRUPTED, TERMINATED = 2, 70, 130, 143

_COMMANDS = {
    name.replace("_", "-"): one
    for module in (scenario_commands, robot_commands)
    for name, one in vars(module).items()
    if isinstance(one, Command)
}

_DESCRIPTION = """\
Plan and track motions of free-floating space manipulators, informed by dynamic coupling.

examples:
  ffsms-pin quickstart                     a notebook to begin with, into the current folder
  ffsms-pin run case-2                     the paper's Case 2, into results/case-2
  ffsms-pin scenario --print case-2        a packaged scenario file, to begin with
  ffsms-pin run mine.toml --out somewhere  a scenario of your own, into a folder of your choice
  ffsms-pin view results/case-2            the motion in the browser, as one HTML file
  ffsms-pin info planar_3r                 masses, limits and coupling of a packaged robot
  ffsms-pin docs scenarios                 a page of the documentation

ffsms-pin COMMAND --help has examples of each command.
"""
_EXITS = "0 target reached; 1 target not reached, results written; 2 bad input or a run that was stopped"


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
            module, _, name = _COMMANDS[arguments.command].function.partition(":")
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
            option = "--" + _OPTIONS.get(argument, argument).replace("_", "-")
            if option in (one.partition("=")[0] for one in given):
                words = option + words.removeprefix(error.name)
        return _failed(f"error: {words}", BAD_INPUT)
    except KeyboardInterrupt as stop:
        asked = isinstance(stop, _Terminated)
        words, status = ("terminated", TERMINATED) if asked else ("interrupted", INTERRUPTED)
        if _COMMANDS[arguments.command].resumes:
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
    if given[0].startswith("-") or given[0] in _COMMANDS:
        return ""
    guess = meant(given[0], _COMMANDS) or f"there are {', '.join(_COMMANDS)}"
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
    commands = whole.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=_Parser)
    for name, command in _COMMANDS.items():
        one = commands.add_parser(
            name,
            help=command.help,
            description=command.description,
            epilog=_exits(command.exits),
            formatter_class=raw,
        )
        if only in (name, None):
            command.add_arguments(one)
    return whole


def _exits(own: str) -> str:
    """The exit codes of a command in words: its own, and those of all."""
    of_all = (
        "70 a defect of ffsms-pin (with FFSMS_PIN_TRACEBACK=1 it says where); 130 interrupted; 143 terminated"
    )
    return textwrap.fill(f"exit codes: {own}; {of_all}", 100)
