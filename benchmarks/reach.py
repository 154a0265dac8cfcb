"""Count the reached targets of arms with seven joints; all targets are reachable by construction.

Run: python benchmarks/reach.py. The table is also the section `space` of `make bench`.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from planner import DT, bent, run_plans
from targets import reachable_targets

import ffsms_pin as ffsms

# The model, and True if the targets are poses.
SETS = (
    ("satellite_xarm7", False),
    ("satellite_panda", True),
    ("satellite_xarm7", True),
    ("space_arm_7", False),
)
EXACT = 1e-3  # [m, rad] largest final error of an exact plan
KAPPA = 10.0


def run(count: int, seed: int, models: list[str] | None = None) -> list[dict[str, Any]]:
    """Plan to `count` targets of each set, from the middle of the joint box (see `bent`)."""
    results = []
    for name, poses in SETS:
        if models and name not in models:
            continue
        sms = ffsms.load(name)
        tasks = reachable_targets(sms, bent(sms), count, seed, DT)
        results.append({"model": name, "poses": poses, "plans": run_plans(sms, tasks, KAPPA, poses)})
    return results


def report(results: list[dict[str, Any]]) -> str:
    """Return a table of plans that keep all limits and meet const8, and of plans that end within `EXACT`."""
    lines = [
        "| model | targets | reached | within 1 mm, 1 mrad | median cost [s] | largest cost [s] | "
        "median time [s] | longest [s] |",
        "|" + "---|" * 8,
    ]
    for r in results:
        plans = r["plans"]
        reached = [row for row in plans if row["reached"]]
        exact = sum(max(row["end_error"], row["end_angle"]) <= EXACT for row in reached)
        costs, seconds = [row["cost"] for row in plans], [row["seconds"] for row in plans]
        lines.append(
            f"| {r['model']} | {'poses' if r['poses'] else 'positions'} | {len(reached)} of {len(plans)} | "
            f"{exact} | {np.median(costs):.4f} | {max(costs):.3f} | {np.median(seconds):.2f} | "
            f"{max(seconds):.1f} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Run the command line."""
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("--count", type=int, default=100, help="targets of each set (default: 100)")
    p.add_argument("--seed", type=int, default=1, help="of the targets (default: 1)")
    p.add_argument("--models", nargs="+", choices=sorted({name for name, _ in SETS}), help="default: all")
    arguments = p.parse_args()
    results = run(arguments.count, arguments.seed, arguments.models)
    print(report(results))
    for r in results:
        for i, row in enumerate(r["plans"]):
            if not row["reached"]:
                print(f"{r['model']}, {'pose' if r['poses'] else 'position'} {i}: {row['note']}")


if __name__ == "__main__":
    main()
