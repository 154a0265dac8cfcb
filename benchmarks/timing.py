"""Timing: calls side by side, in turns, so that other work falls on all alike; and whole commands."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, TypedDict

import numpy as np
from numpy.typing import ArrayLike


class Times(TypedDict):
    """Seconds a call: over the turns."""

    median: float
    p10: float
    p90: float
    least: float


def times(samples: ArrayLike) -> Times:
    """Median, percentiles and least of samples [s]."""
    values = np.asarray(samples, dtype=np.float64)
    low, middle, high = np.percentile(values, [10.0, 50.0, 90.0])
    return {"median": float(middle), "p10": float(low), "p90": float(high), "least": float(values.min())}


def in_turns(calls: Mapping[str, Callable[[int], Any]], turns: int = 60, inner: int = 20) -> dict[str, Times]:
    """Time calls side by side.

    Parameters
    ----------
    calls : mapping of str to callable
        Each is given a running number, to choose its state by.
    turns : int
        How often each has its turn.
    inner : int
        Calls in a turn, each a sample: one that another program interrupts spoils no other.
    """
    for call in calls.values():
        call(0)  # first use fills caches
    samples: dict[str, list[float]] = {name: [] for name in calls}
    now = time.perf_counter
    gc.collect()
    gc.disable()
    try:
        for _ in range(turns):
            for name, call in calls.items():
                taken = samples[name]
                for i in range(inner):
                    begin = now()
                    call(i)
                    taken.append(now() - begin)
    finally:
        gc.enable()
    return {name: times(values) for name, values in samples.items()}


class Cost(NamedTuple):
    """Of a whole command: processor time and time by the clock [s], most memory of its own process [MB]."""

    used: float
    clock: float
    memory: float


def command(words: list[str]) -> Cost:
    """What `ffsms-pin WORDS` costs, its workers included."""
    began = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, "-m", "ffsms_pin", *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    _, status, used = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"ffsms-pin {' '.join(words)} failed: {status}")
    return Cost(used.ru_utime + used.ru_stime, time.perf_counter() - began, used.ru_maxrss / 1024)
