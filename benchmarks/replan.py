"""Measure the time of a re-plan and the final error on random plants, and print a Markdown table.

Run from the repository's root: python benchmarks/replan.py [--plants 10] [--seed 1]
The problems are those of benchmarks/reaching.py. All re-plans of all runs are timed, without the first plans.
The last two columns are ratios to the time of one linearisation of a motion on the initial spline of a
re-plan. That time is measured in the same run, so the ratios do not depend on the machine or its load.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
from reaching import DURATION, problem  # type: ignore[import-not-found]

from ffsms_pin import opt
from ffsms_pin.control import ComputedTorque
from ffsms_pin.opt.replan.options import ReplanOptions
from ffsms_pin.opt.search.gauss_newton import LAST_WEIGHTS, Model, linearise
from ffsms_pin.simulation import random_plants, simulate

ROWS = (("planar_3r", 1), ("planar_3r", 2), ("satellite_panda", 1), ("satellite_panda", 2))


class Timed(opt.Replanning):
    """A reference that records the time of each re-plan [s]."""

    def __init__(self, whole: opt.Problem) -> None:
        super().__init__(whole)
        self.first, self.times = 0.0, list[float]()

    def observe(self, t: float, q: Any, v: Any) -> None:
        """Observe the state, and record the time."""
        begun = self._step < 0
        super().observe(t, q, v)
        if begun:
            self.first = self.computing_time
        elif self.plan_age == 0.0:
            self.times.append(self.computing_time)


def linearisation(whole: opt.Problem) -> float:
    """Return the median time of one linearisation [s]."""
    options = ReplanOptions()
    model = Model.make(whole, options.grid)
    p = np.full((1, model.spline.size, whole.sms.n), 0.01)
    taken = []
    for _ in range(20):
        begun = time.perf_counter()
        linearise(model, p, LAST_WEIGHTS)
        taken.append(time.perf_counter() - begun)
    return float(np.median(taken))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plants", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    print(
        "| robot, case | planned once: within 2 mm | max [mm] | re-planned: within 2 mm | max [mm] "
        "| first plan [ms] | re-plan, median [ms] | 99 % [ms] | median, linearisations | 99 % |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    for robot, case in ROWS:
        sms, q0, target = problem(robot, case)
        whole = opt.Problem(sms, q0, target, DURATION)
        plan = opt.solve(whole)
        once, ends, firsts, times, units = [], [], [], list[float](), []
        for plant in random_plants(sms, np.random.default_rng(arguments.seed), arguments.plants):
            units.append(linearisation(whole))
            reference = Timed(whole)
            law = ComputedTorque(sms, K_p=100.0, K_d=20.0)
            tracking = simulate(sms, reference, law, q0=q0, plant=plant)
            ends.append(1e3 * float(tracking.position_error[-1]))
            tracking = simulate(sms, plan, law, q0=q0, plant=plant)
            once.append(1e3 * float(tracking.position_error[-1]))
            firsts.append(1e3 * reference.first)
            times += reference.times
        middle, most = 1e3 * np.percentile(times, [50.0, 99.0])
        unit = 1e3 * float(np.median(units))
        cells = [
            f"{sum(end <= 2.0 for end in all_)} of {len(all_)} | {max(all_):.2g}" for all_ in (once, ends)
        ]
        print(
            f"| `{robot}`, {case} | {' | '.join(cells)} | {np.median(firsts):.0f} | "
            f"{middle:.1f} | {most:.1f} | {middle / unit:.1f} | {most / unit:.1f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
