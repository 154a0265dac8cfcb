"""Measure the parallel efficiency of `plan_many`, and the time per plan for growing numbers of plans."""

from __future__ import annotations

import time
from itertools import cycle, islice
from typing import Any

from planner import DT, paper_tasks

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.processes import usable_cores

PLANS = 200
TINY = (1, 10, 100, 1000)
TINY_DURATION, TINY_DT = 2.0, 0.1  # [s]


def run(plans: int = PLANS) -> dict[str, Any]:
    """Return the efficiency on up to two cores, and times of up to a thousand small plans."""
    return {"efficiency": efficiency(plans), "tiny": tiny()}


def efficiency(plans: int) -> dict[str, Any]:
    """Return the time of single plans / (cores x time of `plan_many`), for a first and a second call."""
    sms, jobs = ffsms.load("planar_3r"), min(2, usable_cores())
    tasks = paper_tasks(sms, plans, 3)
    arguments = (
        [task.q0 for task in tasks],
        [task.target for task in tasks],
        [task.duration for task in tasks],
    )
    begin = time.perf_counter()
    alone = [opt.plan(sms, task.q0, task.target, task.duration, DT) for task in tasks]
    one_by_one, seconds = time.perf_counter() - begin, []
    for _ in range(2):
        begin = time.perf_counter()
        many = opt.plan_many(sms, *arguments, dt=DT, jobs=jobs)
        seconds.append(time.perf_counter() - begin)
        assert all(a.q.tobytes() == b.q.tobytes() for a, b in zip(alone, many, strict=True))
    return {
        "plans": plans,
        "jobs": jobs,
        "one_by_one": one_by_one,
        "first": seconds[0],
        "second": seconds[1],
        "efficiency_first": one_by_one / jobs / seconds[0],
        "efficiency_second": one_by_one / jobs / seconds[1],
    }


def tiny() -> list[dict[str, Any]]:
    """Return the times of 1 to 1000 small plans of 20 steps each, by `method="step"`."""
    sms = ffsms.load("planar_3r")
    targets = [task.target for task in paper_tasks(sms, 10, 3)]
    q0 = paper_tasks(sms, 1, 3)[0].q0
    rows = []
    for count in TINY:
        some = list(islice(cycle(targets), count))
        begin = time.perf_counter()
        opt.plan_many(sms, q0, some, TINY_DURATION, TINY_DT, method="step")
        seconds = time.perf_counter() - begin
        rows.append({"plans": count, "seconds": seconds, "each": seconds / count})
    return rows
