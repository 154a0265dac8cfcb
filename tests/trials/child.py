"""Run trials in this process: ``python -m trials.child KIND FIRST LAST SECONDS``.

The process writes a line before and a line after each trial, so that its parent can identify the trial that
ended the process. A watchdog in C ends the process if a trial takes too long, even within compiled code.
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

MEMORY = 2**30  # [bytes] of address space for trials, in addition to that of the process after its imports


def main(kind: str, first: int, last: int, limit: float) -> None:
    """Run the trials with seeds from `first` to before `last`, each for `limit` [s] at most."""
    lines = os.fdopen(os.dup(1), "w", buffering=1)
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)  # discard output of libraries
    trial = import_module(f"trials.{kind}").trial
    warnings.simplefilter("error")
    warnings.simplefilter("ignore", FfsmsWarning)  # the library's own warnings are allowed
    if kind != "rogue":
        judged(trial(first).work)  # load lazy imports before memory is limited
    _limit_memory()
    for seed in range(first, last):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # creating wrong values may warn
            trial_of_seed = trial(seed)
        lines.write(json.dumps([seed, trial_of_seed.what]) + "\n")
        faulthandler.dump_traceback_later(limit, exit=True)
        verdict = judged(trial_of_seed.work)
        faulthandler.cancel_dump_traceback_later()
        lines.write(json.dumps([seed, trial_of_seed.what, *verdict]) + "\n")


def _limit_memory() -> None:
    with open("/proc/self/statm") as file:
        taken = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + MEMORY, resource.RLIM_INFINITY))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4]))
