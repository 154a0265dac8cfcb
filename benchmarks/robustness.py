"""How near the end effector ends on plants that are not the model, as a Markdown table.

Run from the repository's root: python benchmarks/robustness.py [--plants 200] [--robot planar_3r] [--case 1]
Each plant is drawn at random: the masses of the arm's bodies +-20 %, mass and inertia of the base +-10 %.
The same plants are driven by re-planning in the loop and by the plan made once, both under computed torque at
1 kHz; re-planning at 100 Hz. With --jobs they are shared out among processes, and the results stay the same.
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.control import ComputedTorque
from ffsms_pin.engine import all_results, outcomes
from ffsms_pin.simulation import random_plants, simulate

DURATION = 12.0
PLANAR = {1: (1.00, 0.15, 0.0), 2: (0.45, 0.75, 0.0)}


def problem(robot: str, case: int) -> tuple[Any, Any, Any]:
    """Robot, start and target."""
    sms = ffsms.load(robot)
    if robot == "planar_3r":
        return sms, sms.configuration(np.deg2rad([1.0, 1.0, 1.0])), np.array(PLANAR[case])
    # In space: a bent arm, and a target half a metre from where its end effector is.
    limits = sms.limits
    middle = 0.5 * (np.clip(limits.lower, -3.0, 3.0) + np.clip(limits.upper, -3.0, 3.0))
    q0 = sms.configuration(middle)
    start = sms.at(q0).end_effector_pose.translation
    way = np.array([[-0.15, 0.35, -0.25], [-0.10, -0.35, 0.30]])[case - 1]
    return sms, q0, start + way


def end(shared: tuple[Any, Any, Any, Any], plant: Any) -> tuple[float, float]:
    """Distance to the target at the end [mm] and the computing time [s], on one plant."""
    sms, q0, target, once = shared
    law = ComputedTorque(sms, K_p=100.0, K_d=20.0)
    begin = time.process_time()
    reference = opt.StepPlanner(sms, dt=0.01).track(target, DURATION) if once is None else once
    tracking = simulate(sms, reference, law, q0=q0, plant=plant)
    return 1e3 * float(tracking.position_error[-1]), time.process_time() - begin


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plants", type=int, default=200)
    parser.add_argument("--robot", default="planar_3r")
    parser.add_argument("--case", type=int, choices=(1, 2), default=None)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--no-open-loop", action="store_true")
    arguments = parser.parse_args()
    print(f"{arguments.plants} random plants of {arguments.robot}, {DURATION:g} s each:\n")
    print("| case | method | within 2 mm | median [mm] | worst [mm] | simulated s a second of computing |")
    print("|---|---|---|---|---|---|")
    for case in (1, 2) if arguments.case is None else (arguments.case,):
        sms, q0, target = problem(arguments.robot, case)
        methods: dict[str, Any] = {"re-planning": None}
        if not arguments.no_open_loop:
            methods["plan made once"] = opt.plan(sms, q0, target, DURATION)
        plants = list(random_plants(sms, np.random.default_rng(arguments.seed), arguments.plants))
        for method, once in methods.items():
            found = outcomes(end, (sms, q0, target, once), plants, arguments.jobs)
            ends, taken = zip(*all_results(found, len(plants)), strict=True)
            good = sum(distance <= 2.0 for distance in ends)
            print(
                f"| {case} | {method} | {good} of {len(ends)} | {np.median(ends):.3g} | {max(ends):.3g} | "
                f"{DURATION * len(ends) / sum(taken):.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
