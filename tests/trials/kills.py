"""Processes that write results, killed at any moment: what they leave is whole, or says that it is not."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from ffsms_pin.errors import ResultError
from ffsms_pin.opt import Trajectory
from ffsms_pin.simulation import Tracking
from trials.good import short_plan, short_run
from trials.judge import Trial

__all__ = ["trial"]

_LATEST = 0.2  # [s] after the first result is there
_PATIENCE = 60.0  # [s] for the process to start on a busy machine


def trial(seed: int) -> Trial:
    """One kill, some time after the process has begun to write."""
    rng = random.Random(f"kill {seed}")
    delay = rng.uniform(0.0, _LATEST)
    return Trial(f"killed {1e3 * delay:.0f} ms after its first result", lambda: _kill(delay))


def _kill(delay: float) -> None:
    for name in ("plan.npz", "run.npz", "stream.npz"):
        Path(name).unlink(missing_ok=True)
    for folder in Path().glob("stream.npz.part*"):
        shutil.rmtree(folder)
    with subprocess.Popen([sys.executable, "-m", "trials.kills"], stdout=subprocess.PIPE) as writer:
        assert writer.stdout is not None
        ready = time.monotonic() + _PATIENCE
        while not writer.stdout.readline():
            if writer.poll() is not None or time.monotonic() > ready:
                raise RuntimeError("the writer did not start")
        time.sleep(delay)
        os.kill(writer.pid, signal.SIGKILL)
    _check_plan(Trajectory.load("plan.npz"))
    _check_run(Tracking.load("run.npz"), short_run())
    if Path("stream.npz").exists():  # of an earlier round; what is beside it is of the one that was killed
        _check_run(Tracking.load("stream.npz", complete=True), short_run())
    part = Path("stream.npz.part")
    try:
        streamed = Tracking.load(part if part.exists() else "stream.npz")
    except ResultError:  # killed before its first row, or while the folder was made: it says so
        return
    _check_run(streamed, short_run())


def _check_plan(plan: Trajectory) -> None:
    wanted = short_plan()
    if not (np.array_equal(plan.q, wanted.q) and np.array_equal(plan.v, wanted.v)):
        raise RuntimeError("plan.npz holds another plan")


def _check_run(run: Tracking, wanted: Tracking) -> None:
    """All rows that are there are those of the run, and a run that was cut off says so."""
    rows = len(run.t)
    if not (np.array_equal(run.q, wanted.q[:rows]) and np.array_equal(run.v, wanted.v[:rows])):
        raise RuntimeError("the recording is not that of the run")
    if rows < len(wanted.t) and not run.note:
        raise RuntimeError("a part of a recording passes for the whole")


def _write_for_ever() -> None:
    """Write the same three results again and again."""
    from ffsms_pin import control, simulate
    from trials.good import STEPS, motion, planar

    plan, run = short_plan(), short_run()
    while True:
        plan.save("plan.npz")
        run.save("run.npz")
        os.write(1, b".\n")
        simulate(planar(), motion(), control.PD(planar()), dt=0.05 / STEPS, stream="stream.npz")


if __name__ == "__main__":
    _write_for_ever()
