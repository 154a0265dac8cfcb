"""Compare plans of the planar robot in 100 and in 200 steps, for two thresholds of the cost.

Run from the repository's root:
    python benchmarks/steps.py [--targets 20]
The search stops at a plan whose cost is below the threshold. The targets are those of benchmarks/targets.py.
The CPU time is that of `opt.solve`, with one thread.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from table import markdown
from targets import reachable_targets

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.opt.search import search as search_module

ENOUGH = (0.01, 8e-4)  # [s] the library's threshold, and a stricter threshold
STEPS = (100, 200)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="plans in 100 and 200 steps")
    parser.add_argument("--targets", type=int, default=20)
    count = parser.parse_args().targets
    sms = ffsms.load("planar_3r")
    tasks = reachable_targets(sms, np.radians([1.0, 1.0, 1.0]), count, 0, 0.02)
    rows = []
    for enough in ENOUGH:
        search_module.CHEAP = enough
        for steps in STEPS:
            spent, costs, reached = [], [], 0
            for task in tasks:
                problem = opt.Problem(sms, task.q0, task.target, task.duration, task.duration / steps)
                began = time.process_time()
                plan = opt.solve(problem)
                spent.append(time.process_time() - began)
                costs.append(float(plan.cost.sum()) * task.duration / steps)
                reached += plan.reached
            numbers = f"{1e3 * np.median(spent):.0f}", f"{np.median(costs):.5f}", f"{reached} of {count}"
            rows.append([f"{enough:g}", str(steps), *numbers])
    head = ["cost at which the search ends [s]", "steps", "CPU [ms], median", "cost [s], median", "reached"]
    print(markdown(head, rows))


if __name__ == "__main__":
    main()
