"""Entry point, errors, signals and exit codes of `ffsms-pin`."""

from __future__ import annotations

import os
import signal
import sys
import traceback
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Any, NoReturn

from ffsms_pin.cli.arguments import BAD_INPUT, command_names, in_options, parser
from ffsms_pin.errors import FfsmsError, FfsmsWarning, InvalidValue, meant

# Exit codes; 0 and 1 are the commands' own.
DEFECT, BROKEN_PIPE, INTERRUPTED, TERMINATED = 70, 141, 130, 143


class _Terminated(KeyboardInterrupt):
    """The end by SIGTERM, after which everything that cleans up after Ctrl-C does so."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line on arguments, by default those of the process, and return the exit code."""
    typed = sys.argv[1:] if argv is None else list(argv)
    if problem := _command_problem(typed):
        return _failed(f"error: {problem} (see ffsms-pin --help)", BAD_INPUT)
    try:
        arguments = parser().parse_args(typed)
    except SystemExit as stop:  # --help, --version, or arguments that cannot be used
        return int(stop.code or 0)
    try:
        with _ended_by_sigterm(), _plain_warnings():
            # Each command is a module, imported here because --help should not wait for the solvers.
            status = int(import_module(f"ffsms_pin.cli.{arguments.command}").run(arguments))
            sys.stdout.flush()
            return status
    except BrokenPipeError:  # the reader has ended, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for what is written at exit
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
            message += "; what is done is kept: the same command goes on from there"
        return _failed(message, status)
    except MemoryError:
        return _failed("error: out of memory; ask for shorter motions or fewer of them", BAD_INPUT)
    except Exception as error:  # anything else is a defect
        if os.environ.get("FFSMS_PIN_TRACEBACK"):
            traceback.print_exc()
        what = " ".join(f"{type(error).__name__}: {error}".split())
        return _failed(f"a defect of ffsms-pin, please report it: {what}", DEFECT)


@contextmanager
def _plain_warnings() -> Iterator[None]:
    """Show the library's warnings as lines of the command line, without the code that they come from."""
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


def _command_problem(given: Sequence[str]) -> str:
    """Return what is wrong with the command, which comes first; empty if nothing is."""
    if not given:
        return "name a command, as: ffsms-pin run case-2"
    names = command_names()
    if given[0].startswith("-") or given[0] in names:
        return ""
    guess = meant(given[0], names) or f"there are {', '.join(names)}"
    return f"there is no command '{given[0]}'; {guess}"


def _failed(message: str, code: int) -> int:
    print(f"ffsms-pin: {message}", file=sys.stderr)  # noqa: T201
    return code


@contextmanager
def _ended_by_sigterm() -> Iterator[None]:
    """Let SIGTERM end the block as Ctrl-C does, unless the signal has a handler already."""

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
