"""Compare joint travel, base rotation and cost of the default plan, classical methods and the paper's step.

Run from the repository's root: python benchmarks/motions.py --targets 100
The starts are drawn from the middle half of the joint ranges, the targets 0.1 to 0.5 m away. Only targets
that a resolved-rate move reaches are used. Ratios are formed for each target.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.files import write_content

DURATION, DT = 12.0, 0.02  # [s]
METHODS = {  # methods, and their labels in the table
    "horizon": "`opt.plan`",
    "base": "`opt.plan(..., base=1)`",
    "step": "the paper's step",
    "resolved-rate": "resolved rate",
    "least-disturbance": "least disturbance",
}
BASE_WEIGHT = 1.0  # weight of the base's rotation in the rows "base"
NUMBERS = ("cost", "travel", "path", "turn", "seconds")


def measured(sms: ffsms.SpaceManipulator, q0: Any, target: Any, method: str) -> dict[str, float]:
    """Return cost [s], joint travel [rad], path over distance, base rotation [rad] and CPU time [s]."""
    begin = time.process_time()
    base = BASE_WEIGHT if method == "base" else 0.0
    chosen = "horizon" if method == "base" else method
    plan = opt.plan(sms, q0, target, DURATION, DT, method=chosen, base=base)
    return {
        "reached": float(plan.reached),
        "cost": plan.cost_integral,
        "travel": plan.joint_travel,
        "path": plan.path_ratio,
        "turn": float(plan.base_rotation.max()),
        "seconds": time.process_time() - begin,
    }


def tasks(sms: ffsms.SpaceManipulator, seed: int) -> Iterator[tuple[Any, Any, dict[str, float]]]:
    """Yield starts, targets, and the numbers of the resolved-rate move to them, endlessly."""
    rng = np.random.default_rng(seed)
    low, high = np.maximum(sms.limits.lower, -np.pi), np.minimum(sms.limits.upper, np.pi)
    while True:
        joints = 0.5 * (low + high) + 0.25 * (high - low) * rng.uniform(-1.0, 1.0, sms.n)
        q0 = sms.configuration(joints)
        way = rng.normal(size=3)
        way *= rng.uniform(0.1, 0.5) / np.linalg.norm(way)
        target = sms.at(q0).end_effector_pose.translation + way
        straight = measured(sms, q0, target, "resolved-rate")
        if straight["reached"]:
            yield q0, target, straight


def rows(name: str, count: int, seed: int) -> list[dict[str, dict[str, float]]]:
    """Return the numbers of all methods for each target."""
    sms = ffsms.load(name)
    found: list[dict[str, dict[str, float]]] = []
    for q0, target, straight in islice(tasks(sms, seed), count):
        row = {"resolved-rate": straight}
        row.update({m: measured(sms, q0, target, m) for m in METHODS if m != "resolved-rate"})
        found.append(row)
    return found


def table(results: dict[str, list[dict[str, dict[str, float]]]]) -> str:
    """Return a Markdown table of medians, and of ratios to the resolved-rate move."""
    head = (
        "| arm | method | reached | cost [s] | travel, ratio (95 %) | path / straight | base rotation, ratio "
        "| time [s] |"
    )
    lines = [head, "|" + "---|" * 8]
    for name, found in results.items():
        for method in METHODS:
            mine = {k: np.array([row[method][k] for row in found]) for k in ("reached", *NUMBERS)}
            other = {k: np.array([row["resolved-rate"][k] for row in found]) for k in NUMBERS}
            travel, turn = mine["travel"] / other["travel"], mine["turn"] / other["turn"]
            middle = {k: float(np.median(values)) for k, values in mine.items()}
            lines.append(
                f"| `{name}` | {METHODS[method]} | {int(mine['reached'].sum())} of {len(found)} "
                f"| {middle['cost']:.2g} "
                f"| {np.median(travel):.2f} ({np.percentile(travel, 95):.1f}) | {middle['path']:.2f} "
                f"| {np.median(turn):.2f} | {middle['seconds']:.2f} |"
            )
        both = [row for row in found if row["step"]["reached"]]
        excess = max(row["horizon"]["cost"] - row["step"]["cost"] for row in both)
        longer = np.median([row["horizon"]["path"] / row["step"]["path"] for row in both])
        lines.append(
            f"| | `opt.plan` compared with the paper's step ({len(both)} targets) | "
            f"| at most + {excess:.2g} | | {longer:.2f} times as long | | |"
        )
    return "\n".join(lines)


def main() -> None:
    """Measure, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    arms = ["satellite_ur5", "satellite_panda", "satellite_xarm7"]
    parser.add_argument("--arms", nargs="+", default=arms)
    parser.add_argument("--targets", type=int, default=100, help="targets per robot (default: 100)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", default="results/motions.json", help="file for all numbers")
    arguments = parser.parse_args()
    results = {name: rows(name, arguments.targets, arguments.seed) for name in arguments.arms}
    path = Path(arguments.out)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_content(path, json.dumps(results, indent=1))
    print(table(results))


if __name__ == "__main__":
    main()
