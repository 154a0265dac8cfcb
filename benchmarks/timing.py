"""Time calls alternately, so that other load affects all of them, and time whole commands."""

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
    """Statistics of the times of one call [s]."""

    median: float
    p10: float
    p90: float
    least: float


def times(samples: ArrayLike) -> Times:
    """Return median, percentiles and least of samples [s]."""
    values = np.asarray(samples, dtype=np.float64)
    low, middle, high = np.percentile(values, [10.0, 50.0, 90.0])
    return {"median": float(middle), "p10": float(low), "p90": float(high), "least": float(values.min())}


def in_turns(calls: Mapping[str, Callable[[int], Any]], turns: int = 60, inner: int = 20) -> dict[str, Times]:
    """Time calls alternately.

    Parameters
    ----------
    calls : mapping of str to callable
        Functions of the index of a state.
    turns : int
        The number of series of each function.
    inner : int
        The number of calls per series. Each call is a sample, so an interruption affects one sample only.
    """
    for call in calls.values():
        call(0)  # the first use fills caches
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
    """The cost of a command: CPU and wall time [s], peak memory of the process without its children [MB]."""

    used: float
    clock: float
    memory: float


def command(words: list[str]) -> Cost:
    """Run `ffsms-pin WORDS` and return its cost; the CPU time includes its workers."""
    began = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, "-m", "ffsms_pin", *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    _, status, used = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"ffsms-pin {' '.join(words)} failed: {status}")
    return Cost(used.ru_utime + used.ru_stime, time.perf_counter() - began, used.ru_maxrss / 1024)
