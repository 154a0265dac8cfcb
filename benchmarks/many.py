"""Many plans over processes: how well the cores are used, and what a plan costs when there are many."""

from __future__ import annotations

import resource
import time
from itertools import cycle, islice
from typing import Any

from planner import DT, paper_tasks

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.engine import end_kept
from ffsms_pin.engine.cluster import usable_cores

PLANS = 200
TINY = (1, 10, 100, 1000)
TINY_DURATION, TINY_DT = 2.0, 0.1  # [s]


def run(plans: int = PLANS) -> dict[str, Any]:
    """Efficiency on the usable cores (two at most), and times of up to a thousand small plans."""
    return {"efficiency": efficiency(plans), "tiny": tiny()}


def efficiency(plans: int) -> dict[str, Any]:
    """Time one by one over cores times the time of `plan_many`, its processes still to start, and started."""
    sms, jobs = ffsms.load("planar_3r"), min(2, usable_cores())
    tasks = paper_tasks(sms, plans, 3)
    arguments = (
        [task.q0 for task in tasks],
        [task.target for task in tasks],
        [task.duration for task in tasks],
    )
    begin, cpu = time.perf_counter(), time.process_time()
    alone = [opt.plan(sms, task.q0, task.target, task.duration, DT) for task in tasks]
    one_by_one, cpu_alone = time.perf_counter() - begin, time.process_time() - cpu
    seconds, before = [], _cpu_of_ended()
    for _ in range(2):
        begin = time.perf_counter()
        many = opt.plan_many(sms, *arguments, dt=DT, jobs=jobs)
        seconds.append(time.perf_counter() - begin)
        assert all(a.q.tobytes() == b.q.tobytes() for a, b in zip(alone, many, strict=True))
    end_kept()  # their processor time is known when they have ended
    cpu_many = _cpu_of_ended() - before
    return {
        "plans": plans,
        "jobs": jobs,
        "one_by_one": one_by_one,
        "cold": seconds[0],
        "warm": seconds[1],
        "efficiency_cold": one_by_one / jobs / seconds[0],
        "efficiency_warm": one_by_one / jobs / seconds[1],
        # Of processor time, which other programs on the machine do not lengthen: work over work and overhead.
        "efficiency_cpu": 2.0 * cpu_alone / cpu_many,
    }


def _cpu_of_ended() -> float:
    """Processor time [s] of this process's children that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def tiny() -> list[dict[str, Any]]:
    """Small plans (20 steps, one after the other) in growing numbers, yielded and dropped."""
    sms = ffsms.load("planar_3r")
    targets = [task.target for task in paper_tasks(sms, 10, 3)]
    q0 = paper_tasks(sms, 1, 3)[0].q0
    tasks = ((q0, target, TINY_DURATION) for target in cycle(targets))
    list(opt.plan_each(sms, islice(tasks, 8), TINY_DT, method="step"))  # the processes start
    rows = []
    for count in TINY:
        begin = time.perf_counter()
        for outcome in opt.plan_each(sms, islice(tasks, count), TINY_DT, method="step"):
            assert outcome.error is None
        seconds = time.perf_counter() - begin
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        rows.append({"plans": count, "seconds": seconds, "each": seconds / count, "peak_MB": peak})
    return rows
