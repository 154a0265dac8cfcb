"""Measure couplings per second of `sms.batch(joints)` and of `sms.at(q).coupling`, on one core.

    OMP_NUM_THREADS=1 python benchmarks/batch.py

A coupling is C_bm, its singular values and its entropy. Each time is the shortest CPU time of several
repetitions. The calls alternate, so that other load on the machine affects all of them.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np

import ffsms_pin as ffsms

ROBOTS = ("planar_3r", "space_arm_7", "satellite_panda", "satellite_ur5")
STATES = 1000  # number of single states per repetition


def seconds(call: Callable[[], object]) -> float:
    """Return the CPU time of one call [s]."""
    begin = time.process_time()
    call()
    return time.process_time() - begin


def rates(name: str, rows: int, turns: int) -> tuple[float, float, float]:
    """Return rates [1/s]: single couplings, couplings of a batch, batch rows with all quantities."""
    sms = ffsms.load(name)
    joints = np.random.default_rng(0).uniform(-2.0, 2.0, (rows, sms.n))
    configurations = [sms.configuration(row) for row in joints[:STATES]]

    def single() -> None:
        for q in configurations:
            state = sms.at(q)
            state.C_bm, state.coupling.sigma, state.coupling.entropy  # noqa: B018

    def coupling() -> None:
        batch = sms.batch(joints)
        batch.C_bm, batch.sigma, batch.entropy  # noqa: B018

    def everything() -> None:
        batch = sms.batch(joints)
        batch.C_bm, batch.J_star, batch.J_m, batch.H_q, batch.sigma, batch.entropy  # noqa: B018
        batch.manipulability, batch.end_effector_position  # noqa: B018

    least = [np.inf] * 3
    for _ in range(turns):
        least = [
            min(old, seconds(call)) for old, call in zip(least, (single, coupling, everything), strict=True)
        ]
    return STATES / least[0], rows / least[1], rows / least[2]


def main() -> None:
    """Print a Markdown table with a row for each robot."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=65536)
    parser.add_argument("--turns", type=int, default=8)
    arguments = parser.parse_args()
    print(
        "| robot | `sms.at(q).coupling` [1/s] | `sms.batch` [1/s] | ratio "
        "| `sms.batch`, all quantities [1/s] |"
    )
    print("|---|---|---|---|---|")
    for name in ROBOTS:
        single, batch, everything = rates(name, arguments.rows, arguments.turns)
        print(f"| `{name}` | {single:.3g} | {batch:.3g} | {batch / single:.1f} | {everything:.3g} |")


if __name__ == "__main__":
    main()
