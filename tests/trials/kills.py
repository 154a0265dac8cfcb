"""Kill processes that write results at random times; their files must be complete."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from ffsms_pin.opt import Trajectory
from ffsms_pin.simulation import Tracking
from trials.calls import plan_by_steps, run_of_steps
from trials.judge import Trial

__all__ = ["trial"]

_LATEST = 0.2  # latest time of a kill after the first result [s]
_PATIENCE = 60.0  # time for the process to start on a busy machine [s]


def trial(seed: int) -> Trial:
    """Return the kill of a seed."""
    rng = random.Random(f"kill {seed}")
    delay = rng.uniform(0.0, _LATEST)
    return Trial(f"killed {1e3 * delay:.0f} ms after its first result", lambda: _kill(delay))


def _kill(delay: float) -> None:
    for name in ("plan.npz", "run.npz"):
        Path(name).unlink(missing_ok=True)
    with subprocess.Popen([sys.executable, "-m", "trials.kills"], stdout=subprocess.PIPE) as writer:
        assert writer.stdout is not None
        ready = time.monotonic() + _PATIENCE
        while not writer.stdout.readline():
            if writer.poll() is not None or time.monotonic() > ready:
                raise RuntimeError("the writer did not start")
        time.sleep(delay)
        os.kill(writer.pid, signal.SIGKILL)
    _check_plan(Trajectory.load("plan.npz"))
    _check_run(Tracking.load("run.npz"), run_of_steps())


def _check_plan(plan: Trajectory) -> None:
    expected = plan_by_steps()
    if not (np.array_equal(plan.q, expected.q) and np.array_equal(plan.v, expected.v)):
        raise RuntimeError("plan.npz holds another plan")


def _check_run(run: Tracking, expected: Tracking) -> None:
    """Raise an error unless the recording is that of the run."""
    if not (np.array_equal(run.q, expected.q) and np.array_equal(run.v, expected.v)):
        raise RuntimeError("the recording is not that of the run")


def _write_repeatedly() -> None:
    """Write the same two results repeatedly."""
    plan, run = plan_by_steps(), run_of_steps()
    while True:
        plan.save("plan.npz")
        run.save("run.npz")
        os.write(1, b".\n")


if __name__ == "__main__":
    _write_repeatedly()
