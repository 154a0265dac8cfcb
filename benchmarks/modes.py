"""Compare many moves of two arms with the base held and floating.

Run: python benchmarks/modes.py --targets 100
The moves are drawn as in `wheels.py`: straight moves of 0.1 to 0.5 m (for `planar_3r` 0.1 to 0.3 m in its
plane) that resolved rates reach in 12 s with a floating base. docs/used-or-fought.md has the results.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from base_strategies import STRATEGIES, mode_numbers, strategies
from table import markdown
from wheels import LARGE, SMALL

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.files import write_content

Keep = Callable[[list[dict[str, Any]]], None]
ARMS = {"planar_3r": (SMALL, 0.3), "satellite_panda": (LARGE, 0.5)}
DURATION, DT = 12.0, 0.02


def moves(name: str, count: int, seed: int, time_limit: float, keep: Keep) -> list[dict[str, Any]]:
    """Return the numbers of each strategy on each move; `keep` is called after each move."""
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
        print(f"\r{name}: {len(found)} of {count}", end="", file=sys.stderr, flush=True)
    return found


def tables(name: str, rows: list[dict[str, Any]]) -> str:
    """Return Markdown tables of medians, and of the share of moves for which "used" needs less.

    Moves that a strategy other than "restored" fails to reach are left out.
    """
    columns = {
        "wheel momentum [N m s]": ("wheel_momentum_max_Nms", 1.0),
        "torque [N m]": ("wheel_torque_max_Nm", 1.0),
        "energy [J]": ("wheel_energy_J", 1.0),
        "time [s]": ("time_s", 1.0),
        "base rotation [deg]": ("rotation_max_deg", 1.0),
        "displacement on return [mm]": ("carried_m", 1e3),
        "joint travel [rad]": ("joint_travel_rad", 1.0),
    }
    common = [row for row in rows if all(row[k]["reached"] for k in STRATEGIES if k != "restored")]
    lines = []
    for strategy in STRATEGIES:
        reached = [row[strategy] for row in rows if row[strategy]["reached"]]
        own = reached if strategy == "restored" else [row[strategy] for row in common]
        medians = [
            f"{unit * np.median([row[key] for row in own]):.3g}" if own else ""
            for key, unit in columns.values()
        ]
        lines.append((strategy, f"{len(reached)} of {len(rows)}", *medians))
    less = []
    for other in ("held", "held-longer", "straight"):
        keys = ("wheel_momentum_max_Nms", "wheel_energy_J")
        pairs = np.array([[(row["used"][key], row[other][key]) for key in keys] for row in common])
        fewer = (pairs[..., 0] < pairs[..., 1]).sum(axis=0)
        ratios = np.median(pairs[..., 0] / pairs[..., 1], axis=0)
        less.append((other, f"{fewer[0]}, {fewer[1]} of {len(common)}", f"{ratios[0]:.2g}, {ratios[1]:.2g}"))
    head = (f"`{name}`", "reached", *columns)
    beside = ("`used` needs less than", "momentum, energy", "median ratio")
    return f"{markdown(head, lines)}\n\n{markdown(beside, less)}"


MISSION = {  # labels of the strategies in the mission table of docs/used-or-fought.md
    "held": "wheels hold the base",
    "used": "coupling used, then turned back",
    "restored": "the arm alone restores the attitude",
    "straight": "straight move, turned back",
}


def mission(name: str, rows: list[dict[str, Any]]) -> str:
    """Return a Markdown table of the costs of a move: medians over the moves that reach their targets."""
    cells = {
        "wheel momentum [N m s]": "wheel_momentum_max_Nms",
        "wheel energy [J]": "wheel_energy_J",
        "base rotation [deg]": "rotation_max_deg",
        "joint travel [rad]": "joint_travel_rad",
        "time [s]": "time_s",
    }
    arrived = [[row[key] for row in rows if row[key]["reached"]] for key in MISSION]
    lines = [("reached", *(f"{len(own)} of {len(rows)}" for own in arrived))]
    lines += [
        (label, *(f"{np.median([row[key] for row in own]):.2g}" for own in arrived))
        for label, key in cells.items()
    ]
    return markdown((f"`{name}`", *MISSION.values()), lines)


def main() -> None:
    """Measure, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--targets", type=int, default=10)
    parser.add_argument("--arms", nargs="+", choices=tuple(ARMS), default=list(ARMS))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--mission", action="store_true", help="the mission table instead")
    parser.add_argument("--time-limit", type=float, default=60.0, help="of each plan [s]")
    parser.add_argument("--out", default="results/modes.json", help="file for all numbers")
    arguments = parser.parse_args()
    path = Path(arguments.out)
    results: dict[str, list[dict[str, Any]]] = {}
    path.parent.mkdir(parents=True, exist_ok=True)

    def keep(rows: list[dict[str, Any]]) -> None:
        results[name] = rows
        write_content(path, json.dumps(results, indent=1))

    for name in arguments.arms:
        rows = moves(name, arguments.targets, arguments.seed, arguments.time_limit, keep)
        print((mission if arguments.mission else tables)(name, rows), flush=True)


if __name__ == "__main__":
    main()
