"""Plan Case 1 and Case 2 repeatedly, with a limit changed by 1e-12, and print the ranges of the results.

Run with one thread:

    OMP_NUM_THREADS=1 python benchmarks/cases.py [--runs 12] [--methods paper horizon] [--settings]

The paper's method (`paper`) finds one of many minima in each step, so its results can depend on rounding.
Quote ranges instead of single runs. `--settings` also plans by the paper's method with other durations,
steps and kappa.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from ffsms_pin import opt
from ffsms_pin.opt.trajectory import ARRIVAL_SHARE
from ffsms_pin.scenarios import scenario
from ffsms_pin.scenarios.closed_loop import planned

CASES = ("case-1", "case-2")
NUDGE = 1e-12  # relative change of one joint's acceleration limit; run i has i times this change
DURATIONS, STEPS, KAPPAS = (10.0, 12.0, 20.0), (0.01, 0.02, 0.05), (5.0, 10.0, 20.0)


def plans(name: str, method: str, runs: int) -> list[opt.Trajectory]:
    """Plan a case once for each changed acceleration limit."""
    case = scenario(name)
    sms, made = case.load(), []
    for i in range(runs):
        acceleration = sms.limits.acceleration.copy()
        acceleration[i % sms.n] *= 1.0 + i * NUDGE
        robot = sms.with_limits(replace(sms.limits, acceleration=acceleration))
        made.append(planned(case, robot, case.start_configuration(robot), None, method))
    return made


def numbers(plan: opt.Trajectory) -> dict[str, float]:
    """Return the quantities that the paper discusses; cos(theta_a) only before the final 10 % (const8)."""
    before = plan.cos_theta[plan.t[:-1] < ARRIVAL_SHARE * plan.duration]
    base = np.linalg.norm(plan.q[:, :3] - plan.q[0, :3], axis=1)
    return {
        "final error [mm]": 1e3 * float(plan.position_error[-1]),
        "cost integral [s]": plan.cost_integral,
        "largest base rotation [deg]": float(np.degrees(plan.base_rotation.max())),
        "largest base displacement [mm]": 1e3 * float(base.max()),
        "smallest cos(theta_a)": float(before.min()),
        "time with cos(theta_a) < 0 [%]": 100.0 * float((before < 0.0).mean()),
        "joint travel [rad]": plan.joint_travel,
    }


def print_ranges(methods: list[str], runs: int) -> None:
    """Print a table for each case, with the smallest and the largest values of the runs."""
    for name in CASES:
        found = {method: plans(name, method, runs) for method in methods}
        print(f"\n{name}, {runs} runs per method\n")
        print(f"| | {' | '.join(methods)} |\n|---{'|---' * len(methods)}|")
        reached = [f"{sum(plan.reached for plan in made)} of {runs}" for made in found.values()]
        print(f"| reached | {' | '.join(reached)} |")
        rows = {method: [numbers(plan) for plan in made] for method, made in found.items()}
        for label in rows[methods[0]][0]:
            ranges = [_range([row[label] for row in rows[method]]) for method in methods]
            print(f"| {label} | {' | '.join(ranges)} |")


def print_settings() -> None:
    """Plan by the paper's method with other durations, steps and kappa; print reach and final error."""
    for name in CASES:
        case = scenario(name)
        sms, errors, count = case.load(), [], 0
        q0 = case.start_configuration(sms)
        for duration in DURATIONS:
            for dt in STEPS:
                for kappa in KAPPAS:
                    target = case.target["position"]
                    plan = opt.plan(sms, q0, target, duration, dt, kappa, method="paper", collision="points")
                    count += plan.reached
                    errors.append(1e3 * float(plan.position_error[-1]))
        print(f"\n{name}, other settings: {count} of {len(errors)} reached, final error {_range(errors)} mm")


def _range(values: list[float]) -> str:
    low, high = (f"{value:.2g}" for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="Ranges of the cases over tiny changes of a limit.")
    parser.add_argument("--runs", type=int, default=12)
    parser.add_argument("--methods", nargs="+", default=["paper", "horizon"], choices=opt.METHODS)
    parser.add_argument("--settings", action="store_true", help="also other durations, steps and kappa")
    arguments = parser.parse_args()
    print_ranges(arguments.methods, arguments.runs)
    if arguments.settings:
        print_settings()


if __name__ == "__main__":
    main()
