"""Compare the roughness of a re-planned motion with that of a motion planned once; print a Markdown table.

Run from the repository's root: python benchmarks/roughness.py [--plants 3]
The problems are those of benchmarks/reaching.py, the wrong plants and the sensors those of
benchmarks/noise.py. The reference is updated at 100 Hz and re-planned every 0.1 s, and computed torque at
1 kHz. The table has the largest values over all plants: the change of a torque between two control steps,
torque, joint acceleration, and final error. Noisy measurements are filtered for both motions.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from noise import SENSORS, random_plant
from reaching import DURATION, problem

from ffsms_pin import opt
from ffsms_pin.control import ComputedTorque
from ffsms_pin.simulation import Conditions, simulate

ROWS = (("planar_3r", 1), ("planar_3r", 2), ("satellite_panda", 1), ("satellite_panda", 2))


def measured(sms: Any, reference: Any, plan: Any, plant: Any, sensors: Any) -> list[float]:
    """Return torque step and torque [N m], acceleration [deg/s^2] and final error [mm] of one run."""
    law = ComputedTorque(sms, K_p=100.0, K_d=20.0)
    run = simulate(
        sms, reference, law, q0=plan.q[0], plant=plant, conditions=Conditions(sensors=sensors, estimator=True)
    )
    accelerations = np.diff(run.v[:, 6:], axis=0) / np.diff(run.t)[:, None]
    found = np.diff(run.tau, axis=0), run.tau, np.degrees(accelerations)
    return [*(float(np.abs(one).max()) for one in found), 1e3 * float(run.position_error[-1])]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plants", type=int, default=3, help="number of random plants")
    parser.add_argument("--rows", type=int, nargs="*", default=range(len(ROWS)), help="which rows")
    arguments = parser.parse_args()
    print(
        "| robot, case | model | sensors | planned once: torque step [N m], torque [N m], "
        "acceleration [deg/s^2], error [mm] | re-planned | ratio of the torque steps |"
    )
    print("|---|---|---|---|---|---|")
    for robot, case in (ROWS[i] for i in arguments.rows):
        sms, q0, target = problem(robot, case)
        plan = opt.plan(sms, q0, target, DURATION)
        rng = np.random.default_rng(1)
        wrong = [random_plant(sms, rng) for _ in range(arguments.plants)]
        for model, plants in (("right", [sms]), ("wrong", wrong)):
            for kind, sensors in (("perfect", None), ("noisy", SENSORS)):
                both = []
                for plant in plants:
                    again = opt.Replanning(opt.Problem(sms, q0, target, DURATION), plan=plan)
                    both.append([measured(sms, one, plan, plant, sensors) for one in (plan, again)])
                once, again = np.max(both, axis=0)
                cells = [", ".join(f"{x:.2g}" for x in one) for one in (once, again)]
                print(
                    f"| {robot}, {case} | {model} | {kind} | {' | '.join(cells)} "
                    f"| {again[0] / once[0]:.2f} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
