"""Plan and simulate many motions in two processes.

Run: python examples/many_plans.py
"""

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import opt


def main() -> None:
    """Plan to random targets, and simulate each plan on a plant with other masses."""
    sms = ffsms.load("planar_3r")
    q0 = sms.configuration([0.4, 0.7, -0.5])
    rng = np.random.default_rng(1)
    start = sms.at(q0).end_effector_pose.translation
    targets = start + rng.uniform(-0.06, 0.06, (8, 3)) * [1.0, 1.0, 0.0]  # the arm moves in a plane
    plans = opt.plan_many(sms, q0, targets, duration=6.0, dt=0.05, jobs=2)

    plants = list(ffsms.simulation.random_plants(sms, rng, len(plans)))
    law = ffsms.control.ComputedTorque(sms)
    runs = ffsms.simulate_many(sms, plans, law, 0.01, plant=plants, jobs=2)

    for plan, run in zip(plans, runs, strict=True):
        print(f"{plan}: {1e3 * run.position_error[-1]:.1f} mm position error on another plant")
    assert all(plan.reached for plan in plans)
    assert all(run.position_error[-1] < 0.03 for run in runs)


if __name__ == "__main__":  # each process imports this script
    main()
