"""Coupling used against coupling fought: many moves of two arms, with the base held and floating.

`python benchmarks/modes.py --targets 100`. The moves are drawn as those of `wheels.py`: straight moves of
0.1 to 0.5 m that resolved rates can make in 12 s with the base floating (0.1 to 0.3 m for `planar_3r`, in its
plane). docs/used-or-fought.md says what came out.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from wheels import LARGE, SMALL

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.storage import write_content
from ffsms_pin.studies.modes import STRATEGIES, mode_numbers, strategies

Keep = Callable[[list[dict[str, Any]]], None]
ARMS = {"planar_3r": (SMALL, 0.3), "satellite_panda": (LARGE, 0.5)}
DURATION, DT = 12.0, 0.02


def moves(name: str, count: int, seed: int, time_limit: float, keep: Keep) -> list[dict[str, Any]]:
    """What each strategy comes to on each move; `keep` is given what there is after each."""
    wheels, farthest = ARMS[name]
    sms, rng = ffsms.load(name).with_actuators(wheels=wheels), np.random.default_rng(seed)
    low, high = np.maximum(sms.limits.lower, -np.pi), np.minimum(sms.limits.upper, np.pi)
    found: list[dict[str, Any]] = []
    while len(found) < count:
        q0 = sms.configuration(0.5 * (low + high) + 0.25 * (high - low) * rng.uniform(-1.0, 1.0, sms.n))
        way = rng.normal(size=3)
        if name == "planar_3r":
            way[2] = 0.0
        way *= rng.uniform(0.1, farthest) / np.linalg.norm(way)
        target = sms.at(q0).end_effector_pose.translation + way
        if not opt.plan(sms, q0, target, DURATION, DT, method="resolved-rate").reached:
            continue
        began = time.process_time()
        problem = opt.Problem(sms, q0, target, DURATION, DT)
        row = mode_numbers(strategies(problem, opt.SearchOptions(time_limit=time_limit)))
        found.append({**row, "cpu_s": time.process_time() - began})
        keep(found)
        print(name, len(found), {k: _short(row[k]) for k in STRATEGIES}, flush=True)
    return found


def _short(row: dict[str, Any]) -> str:
    there = "" if row["reached"] else "not reached, "
    return f"{there}{row['wheel_momentum_max_Nms']:.3g} N m s, {row['wheel_energy_J']:.3g} J"


def summary(rows: list[dict[str, Any]]) -> list[str]:
    """One line of a table a strategy: medians over the moves that all but "restored" reach."""
    keys = (
        "wheel_momentum_max_Nms",
        "wheel_torque_max_Nm",
        "wheel_energy_J",
        "time_s",
        "rotation_max_deg",
        "carried_m",
        "joint_travel_rad",
    )
    common = [row for row in rows if all(row[k]["reached"] for k in STRATEGIES if k != "restored")]
    lines = [f"medians over the {len(common)} of {len(rows)} moves that all but 'restored' reach"]
    lines.append(" | ".join(("strategy", "reached", *keys)))
    for name in STRATEGIES:
        reached = sum(row[name]["reached"] for row in rows)
        own = common if name != "restored" else [row for row in rows if row[name]["reached"]]
        medians = [f"{np.median([row[name][k] for row in own]):.3g}" if own else "-" for k in keys]
        lines.append(" | ".join((name, f"{reached} of {len(rows)}", *medians)))
    for other in ("held", "held-longer", "straight"):
        for key in ("wheel_momentum_max_Nms", "wheel_energy_J"):
            less = sum(row["used"][key] < row[other][key] for row in common)
            ratio = np.median([row["used"][key] / row[other][key] for row in common]) if common else np.nan
            lines.append(f"used < {other} in {key}: {less} of {len(common)}, median ratio {ratio:.2g}")
    return lines


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--targets", type=int, default=10)
    parser.add_argument("--arms", nargs="+", choices=tuple(ARMS), default=list(ARMS))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--time-limit", type=float, default=60.0, help="of each plan [s]")
    parser.add_argument("--out", default="results/modes.json", help="file for all numbers")
    arguments = parser.parse_args()
    path, results = Path(arguments.out), {}
    path.parent.mkdir(parents=True, exist_ok=True)

    def keep(rows: list[dict[str, Any]]) -> None:
        results[name] = rows
        write_content(path, json.dumps(results, indent=1))

    for name in arguments.arms:
        rows = moves(name, arguments.targets, arguments.seed, arguments.time_limit, keep)
        for line in summary(rows):
            print(line, flush=True)


if __name__ == "__main__":
    main()
