"""Inspect other processes, for tests that kill processes."""

from __future__ import annotations

import time
from collections.abc import Callable

import psutil

__all__ = ["command_of", "running", "wait_until"]


def running(processes: list[psutil.Process]) -> list[psutil.Process]:
    """Return the processes that still run."""
    return [process for process in processes if _runs(process)]


def command_of(process: psutil.Process) -> str:
    """Return the command line of a process, or an empty text if it has ended."""
    try:
        return " ".join(process.cmdline())
    except psutil.Error:
        return ""


def wait_until(happened: Callable[[], bool], seconds: float) -> bool:
    """Return whether a condition becomes true within `seconds`."""
    end = time.monotonic() + seconds
    while not happened() and time.monotonic() < end:
        time.sleep(0.02)
    return happened()


def _runs(process: psutil.Process) -> bool:
    try:
        return bool(process.is_running() and process.status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:  # it ended between the two calls
        return False
