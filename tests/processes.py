"""Other processes, as tests of kills look at them."""

from __future__ import annotations

import time
from collections.abc import Callable

import psutil

__all__ = ["alive", "command_of", "waited"]


def alive(processes: list[psutil.Process]) -> list[psutil.Process]:
    """Those that still run."""
    return [one for one in processes if _runs(one)]


def command_of(process: psutil.Process) -> str:
    """The command line of a process; nothing where it has ended meanwhile."""
    try:
        return " ".join(process.cmdline())
    except psutil.Error:
        return ""


def waited(happened: Callable[[], bool], seconds: float) -> bool:
    """Whether something happens within so many seconds."""
    end = time.monotonic() + seconds
    while not happened() and time.monotonic() < end:
        time.sleep(0.02)
    return happened()


def _runs(process: psutil.Process) -> bool:
    try:
        return bool(process.is_running() and process.status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:  # it ended between the two questions
        return False
