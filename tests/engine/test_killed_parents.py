"""Processes whose parent is killed or told to end: none is left, and nothing of theirs either."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest
from processes import alive, command_of, waited

WITHIN = 5.0  # [s]

PLANS = """
import numpy as np
import ffsms_pin as ffsms
from ffsms_pin import opt
sms = ffsms.load("planar_3r")
q0 = sms.configuration(np.radians([1, 1, 1]))
tasks = ((q0, [0.8, 0.5, 0.0], 6.0) for _ in range(100_000))
for _ in opt.plan_each(sms, tasks, jobs=2):
    print("one", flush=True)
"""
SIMULATIONS = """
import sys
sys.path.insert(0, {folder!r})
from motions import Swing
import ffsms_pin as ffsms
from ffsms_pin.simulation import simulate_each
sms = ffsms.load("planar_3r")
task = dict(reference=Swing(sms), controller=ffsms.SlidingModeController(sms))
for _ in simulate_each(sms, (task for _ in range(100_000)), jobs=2):
    print("one", flush=True)
"""
# Workers that are asleep when the parent dies, as after a short call.
IDLE = """
import time
from ffsms_pin.engine import outcomes
def work(shared, task):
    return task
list(outcomes(work, None, range(4), jobs=2))
print("one", flush=True)
time.sleep(600)
"""


def remains(folder: Path) -> list[Path]:
    """What a process and its workers left in its folder for temporary files."""
    return list((folder / "temporary").iterdir())


@contextmanager
def begun(
    command: list[str], folder: Path, ready: Callable[[], bool]
) -> Iterator[tuple[subprocess.Popen[str], list[psutil.Process]]]:
    """A process that is at work, and all below it; none is left at the end, come what may."""
    (folder / "temporary").mkdir()
    with (folder / "out").open("w") as out, (folder / "err").open("w") as err:
        process = subprocess.Popen(
            command,
            cwd=folder,
            stdout=out,
            stderr=err,
            text=True,
            env={**os.environ, "TMPDIR": str(folder / "temporary")},
            preexec_fn=lambda: signal.signal(signal.SIGTERM, signal.SIG_DFL),
        )
    everyone: list[psutil.Process] = []
    try:
        waited(lambda: ready() or process.poll() is not None, 120.0)
        assert process.poll() is None, (folder / "err").read_text()
        assert waited(lambda: len(workers_of(process)) == 2, 60.0)
        everyone += psutil.Process(process.pid).children(recursive=True)
        yield process, everyone
    finally:
        process.kill()
        process.wait(timeout=60.0)
        for one in everyone:
            if one.is_running():
                one.kill()


def workers_of(process: subprocess.Popen[str]) -> list[psutil.Process]:
    """The processes that work."""
    found = psutil.Process(process.pid).children(recursive=True)
    return [one for one in found if "ffsms_pin.engine.worker" in command_of(one)]


@pytest.mark.parametrize("script", [PLANS, SIMULATIONS, IDLE], ids=["plans", "simulations", "idle"])
def test_workers_end_with_a_killed_parent(tmp_path: Path, script: str) -> None:
    code = script.replace("{folder!r}", repr(str(Path(__file__).parents[1])))
    ready = lambda: "one" in (tmp_path / "out").read_text()  # noqa: E731
    with begun([sys.executable, "-c", code], tmp_path, ready) as (process, everyone):
        process.kill()
        assert process.wait(timeout=60.0) == -signal.SIGKILL
        assert waited(lambda: not alive(everyone), WITHIN), "workers outlived their parent"
        assert not remains(tmp_path)


@pytest.mark.parametrize(("sent", "status"), [("SIGKILL", -9), ("SIGTERM", 143)])
def test_robustness_ends_whole(tmp_path: Path, sent: str, status: int) -> None:
    command = [sys.executable, "-m", "ffsms_pin", "robustness", "case-1", "--plants", "500", "--jobs", "2"]
    ready = lambda: "planning: done" in (tmp_path / "err").read_text()  # noqa: E731
    with begun(command, tmp_path, ready) as (process, everyone):
        process.send_signal(getattr(signal, sent))
        assert process.wait(timeout=WITHIN) == status
        assert waited(lambda: not alive(everyone), WITHIN), "workers outlived their parent"
        assert not remains(tmp_path)
    results = tmp_path / "results"
    left = {path.name for path in results.iterdir()}
    kept = "case-1-robustness.parts"  # runs that are done: the same command goes on from there
    if sent == "SIGTERM":
        *lines, last = (tmp_path / "err").read_text().splitlines()
        assert any(line.startswith("planning: done") for line in lines)
        assert last.startswith("ffsms-pin: terminated; what is done is kept")
        assert left <= {kept}
    else:  # the next run into this folder removes it
        (hidden,) = left - {kept}
        assert hidden.startswith(".case-1-robustness.ffsms-pin-")
