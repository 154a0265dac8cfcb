"""Tasks one by one over the engine's workers, which stay for the next call."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import psutil
import pytest

import ffsms_pin as ffsms
from ffsms_pin.engine import Outcome, end_kept, outcomes, tasks
from ffsms_pin.engine.cluster import quiet
from ffsms_pin.errors import DependencyMissing, TaskError

PAUSE = 0.1  # [s]


def workers() -> set[int]:
    """Processes of workers that live."""
    return {
        one.pid
        for one in psutil.Process().children()
        if one.status() != psutil.STATUS_ZOMBIE and "ffsms_pin.engine.worker" in " ".join(one.cmdline())
    }


@pytest.fixture(autouse=True)
def _nobody_waits() -> Iterator[None]:
    end_kept()
    yield
    end_kept()
    assert not workers()


def pid(_: None, task: int) -> tuple[int, int]:
    time.sleep(PAUSE)
    return task, os.getpid()


def pids(found: list[Outcome[tuple[int, int]]]) -> set[int]:
    assert [one.index for one in found] == [one.result[0] for one in found if one.result is not None]
    return {one.result[1] for one in found if one.result is not None}


def test_the_next_call_finds_the_workers_there(monkeypatch: pytest.MonkeyPatch) -> None:
    at_work = pids(list(outcomes(pid, None, range(8), jobs=2)))
    first = workers()
    assert at_work <= first
    assert len(first) == 2
    second = outcomes(pid, None, range(8), jobs=2)
    next(second)
    assert workers() == first
    beside = pids(list(outcomes(pid, None, range(2), jobs=2)))  # at the same time: has its own
    assert not beside & first
    second.close()
    assert len(workers()) == 2  # one cluster waits, not two
    monkeypatch.setattr(tasks, "IDLE", 0.2)
    list(outcomes(pid, None, range(2), jobs=2))
    end = time.monotonic() + 30.0
    while workers() and time.monotonic() < end:
        time.sleep(PAUSE)
    assert not workers()


def test_a_worker_that_is_killed_from_outside_costs_no_task() -> None:
    found: list[Outcome[tuple[int, int]]] = []
    for one in outcomes(pid, None, range(30), jobs=2):
        found.append(one)
        if one.index == 5 and one.result is not None:
            psutil.Process(one.result[1]).kill()
    assert len(pids(found)) >= 2
    assert [one.error for one in found] == [None] * 30
    assert [one.index for one in found] == list(range(30))


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_task_has_its_own_copy(jobs: int) -> None:
    """Of what functions remember too; so chunks and processes do not show in the results."""
    calls: list[int] = []

    def counted() -> int:
        calls.append(0)
        return len(calls)

    same = np.zeros(1)

    def work(_: None, task: tuple[Callable[[], int], Any]) -> tuple[int, float]:
        task[1][0] += 1.0
        return task[0](), float(task[1][0])

    found = list(outcomes(work, None, [(counted, same)] * 300, jobs=jobs))
    assert [one.result for one in found] == [(1, 1.0)] * 300
    assert not calls
    assert same[0] == 0.0


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_cannot_be_sent_fails_its_own_task(jobs: int) -> None:
    tasks = [1, threading.Lock(), 3]
    first, second, third = outcomes(lambda _, task: task, None, tasks, jobs=jobs)
    assert (first.result, third.result) == (1, 3)
    assert isinstance(second.error, (TaskError, TypeError))
    assert "pickle" in str(second.error)


def test_without_dask_one_process_works(
    planar: ffsms.SpaceManipulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    for package in ("distributed", "dask", "dask.system", "cloudpickle"):
        monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(DependencyMissing, match=r"pip install 'ffsms-pin\[cluster\]'"):
        outcomes(pid, None, [1], jobs=2)  # before anything is asked for
    assert pids(list(outcomes(pid, None, range(2)))) == {os.getpid()}
    q0 = planar.configuration([0.1, 0.2, 0.3])
    target = (0.9, 0.3, 0.0)
    (found,) = ffsms.opt.plan_many(planar, q0, [target], 2.0, 0.1, method="step")
    assert found.q.tobytes() == ffsms.opt.plan(planar, q0, target, 2.0, 0.1, method="step").q.tobytes()
    law = ffsms.SlidingModeController(planar)
    runs = ffsms.simulate_many(planar, [found, found], law, 0.05)
    alone = ffsms.simulate(planar, found, law, 0.05)
    assert [run.tau.tobytes() for run in runs] == [alone.tau.tobytes()] * 2


LEFT_OPEN = """
from ffsms_pin.engine import outcomes
def work(shared, task):
    return shared + task
open_still = outcomes(work, 1, range(100_000), jobs=2)
print(next(open_still).result)
"""


def test_a_script_that_ends_in_the_middle_ends_its_workers() -> None:
    done = subprocess.run(
        [sys.executable, "-c", LEFT_OPEN], capture_output=True, text=True, timeout=120, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "1\n", "")


def test_quiet_uses_may_end_in_any_order() -> None:
    logger = logging.getLogger("distributed")
    before = logger.level
    one = other = quiet
    one.__enter__()
    other.__enter__()
    one.__exit__(None, None, None)
    assert logger.level > logging.CRITICAL
    other.__exit__(None, None, None)
    assert logger.level == before
