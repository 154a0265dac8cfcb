"""`make bench`: reach, cost and time of the planner, beside the full nonlinear programme by IPOPT.

Prints Markdown tables and writes all numbers as JSON.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from ipopt import solve
from planner import DT, paper_tasks, run_plans, smoothness

import ffsms_pin as ffsms

COARSE = 100  # steps of the nonlinear programme
TIME_LIMIT = 120.0  # [s] of one of its solutions


def main() -> None:
    """Run the benchmarks that the command line asks for."""
    arguments = parser().parse_args()
    sms = ffsms.load("planar_3r")
    out: dict[str, Any] = {"arguments": {k: v for k, v in vars(arguments).items() if k != "out"}}
    out["reach"] = [
        reach(sms, kappa, seed, arguments.reach) for kappa in arguments.kappa for seed in arguments.seeds
    ]
    print_reach(out["reach"])
    out["cost"] = [
        compare(sms, kappa, seed, arguments.targets, arguments.fine)
        for kappa in arguments.kappa
        for seed in arguments.seeds
    ]
    print_costs(out["cost"])
    path = Path(arguments.out)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part")
    part.write_text(json.dumps(out, indent=1))
    os.replace(part, path)
    print(f"\nAll numbers: {path}")


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("--seeds", type=int, nargs="+", default=[2], help="of the targets (default: 2)")
    p.add_argument("--kappa", type=float, nargs="+", default=[10.0, 1.0], help="default: 10 1")
    p.add_argument("--reach", type=int, default=300, help="targets for reach, a seed (default: 300)")
    p.add_argument("--targets", type=int, default=20, help="targets beside IPOPT, a seed (default: 20)")
    p.add_argument(
        "--fine", type=int, default=3, help="of these, how many on the plan's own grid (default: 3)"
    )
    p.add_argument("--out", default="results/bench.json", help="file for all numbers")
    return p


def reach(sms: ffsms.SpaceManipulator, kappa: float, seed: int, count: int) -> dict[str, Any]:
    """Plans alone, many of them."""
    return {"kappa": kappa, "seed": seed, "plans": run_plans(sms, paper_tasks(sms, count, seed), kappa)}


def compare(sms: ffsms.SpaceManipulator, kappa: float, seed: int, count: int, fine: int) -> dict[str, Any]:
    """Plans and the nonlinear programme on the same tasks, on its own coarse grid and on the plans' grid."""
    tasks = paper_tasks(sms, count, seed)
    result: dict[str, Any] = {"kappa": kappa, "seed": seed, "plans": run_plans(sms, tasks, kappa)}
    for name, chosen in (("coarse", tasks), ("fine", tasks[:fine])):
        rows = []
        for task in chosen:
            steps = COARSE if name == "coarse" else round(task.duration / DT)
            found = solve(sms, task, kappa, steps, TIME_LIMIT)
            rows.append(
                {
                    "converged": found.converged,
                    "status": found.status,
                    "cost": found.cost,
                    "seconds": found.seconds,
                    "build_seconds": found.build_seconds,
                    **smoothness(found.rates, task.duration / steps),
                }
            )
        result[name] = rows
    return result


def median(rows: list[dict[str, Any]], key: str) -> float:
    """Median of a column; NaN of none."""
    return float(np.median([row[key] for row in rows])) if rows else float("nan")


def print_reach(results: list[dict[str, Any]]) -> None:
    """Reach: every limit and clearance kept, const8 met."""
    print("| kappa | seed | reached | median cost [s] | largest cost [s] | median time [ms] | longest [ms] |")
    print("|---|---|---|---|---|---|---|")
    for r in results:
        plans = r["plans"]
        reached, longest = sum(row["reached"] for row in plans), max(row["seconds"] for row in plans)
        print(
            f"| {r['kappa']:g} | {r['seed']} | {reached} of {len(plans)} | {median(plans, 'cost'):.5f} | "
            f"{max(row['cost'] for row in plans):.4f} | {1e3 * median(plans, 'seconds'):.0f} | "
            f"{1e3 * longest:.0f} |"
        )


def print_costs(results: list[dict[str, Any]]) -> None:
    """Ours beside IPOPT: medians over the same targets."""
    print(
        "\n| kappa | seed | planner | done | median cost [s] | worst excess of ours [s] | median time [ms] | "
        "building [ms] | times ours | sign changes | integral of squared acceleration |"
    )
    print("|" + "---|" * 11)
    for r in results:
        plans = r["plans"]
        row_of("opt.plan", r, plans, plans)
        for name, label in (("coarse", f"IPOPT, {COARSE} steps"), ("fine", "IPOPT, the plan's own steps")):
            if r[name]:
                row_of(label, r, r[name], plans[: len(r[name])])


def row_of(label: str, r: dict[str, Any], rows: list[dict[str, Any]], plans: list[dict[str, Any]]) -> None:
    """One row of the cost table; `plans` are ours for the same targets."""
    ours = rows is plans
    done = sum(row["reached" if ours else "converged"] for row in rows)
    seconds, own = median(rows, "seconds"), median(plans, "seconds")
    pairs = [
        (p["cost"] - row["cost"]) for p, row in zip(plans, rows, strict=True) if ours or row["converged"]
    ]
    excess = "" if ours else f"{max(pairs, default=float('nan')):.4f}"
    build = "" if ours else f"{1e3 * median(rows, 'build_seconds'):.0f}"
    ratio = "" if ours else f"{seconds / own:.0f}"
    print(
        f"| {r['kappa']:g} | {r['seed']} | {label} | {done} of {len(rows)} | "
        f"{median(rows, 'cost'):.5f} | {excess} | "
        f"{1e3 * seconds:.0f} | {build} | {ratio} | {median(rows, 'sign_changes'):.0f} | "
        f"{median(rows, 'squared_acceleration'):.3f} |"
    )


if __name__ == "__main__":
    main()
