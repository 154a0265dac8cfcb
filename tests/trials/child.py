"""A process that runs trials one after the other: ``python -m trials.child KIND FIRST LAST SECONDS``.

It writes two lines a trial, one before and one after, so that its parent knows which one it died of. A
watchdog in C ends the process when a trial takes too long, even one that never comes back to Python.
"""

from __future__ import annotations

import faulthandler
import json
import os
import resource
import sys
import warnings
from importlib import import_module

from ffsms_pin.errors import FfsmsWarning
from trials.judge import judged

__all__ = ["MEMORY"]

MEMORY = 2**30  # [bytes] of address space that trials may take beyond what the process has after its imports


def main(kind: str, first: int, last: int, limit: float) -> None:
    """Run the trials with seeds from `first` to before `last`, each for `limit` [s] at most."""
    lines = os.fdopen(os.dup(1), "w", buffering=1)
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)  # what a library prints does not come between
    trial = import_module(f"trials.{kind}").trial
    warnings.simplefilter("error")
    warnings.simplefilter("ignore", FfsmsWarning)  # the library's own are meant
    if kind != "rogue":
        judged(trial(first).work)  # what loads when it is first used is loaded now
    _limit_memory()
    for seed in range(first, last):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # values that are wrong may warn when they are made
            one = trial(seed)
        lines.write(json.dumps([seed, one.what]) + "\n")
        faulthandler.dump_traceback_later(limit, exit=True)
        verdict = judged(one.work)
        faulthandler.cancel_dump_traceback_later()
        lines.write(json.dumps([seed, one.what, *verdict]) + "\n")


def _limit_memory() -> None:
    with open("/proc/self/statm") as file:
        taken = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + MEMORY, resource.RLIM_INFINITY))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4]))
