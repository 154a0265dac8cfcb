"""Run `make bench`: speed, reach and cost of the library, of its lower bounds and of other libraries.

All tables are written to one Markdown file and all numbers to one JSON file. `--only` chooses sections. One
core is used, except for the section `many`. Compare ratios, because their numerators and denominators are
measured alternately in the same run.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import clearances
import machine
import many
import numpy as np
import peers
import reach as space
import sizes
import startup
import state_floor
import step_floor
import strategies
import table
from planner import DT, paper_tasks, run_plans, smoothness

import ffsms_pin as ffsms
from ffsms_pin.files import write_content

COARSE = 100  # number of steps of the nonlinear program
TIME_LIMIT = 120.0  # [s] time limit of a solution
# The forms of the program: label, True for the plan's time grid, `expanded` of `ipopt.solve`.
FORMS = {
    "coarse": (f"IPOPT, {COARSE} steps", False, True),
    "graph": (f"IPOPT, {COARSE} steps, as a graph", False, False),
    "fine": ("IPOPT, the plan's own steps", True, True),
}

# The sections: heading, function that measures, and function that makes the table.
Section = tuple[str, Callable[[argparse.Namespace], Any], Callable[[Any], str]]


def main() -> None:
    """Run the chosen sections; the files are written after each section."""
    arguments = parser().parse_args()
    out: dict[str, Any] = {
        "arguments": {k: v for k, v in vars(arguments).items() if k != "out"},
        "machine": machine.facts(),
        "seconds": {},
    }
    parts = ["# Measured by `make bench`", table.machine(out["machine"])]
    if not arguments.bare:
        print("\n\n".join(parts), flush=True)
    path = Path(arguments.out)
    path.parent.mkdir(parents=True, exist_ok=True)
    for name in arguments.only:
        heading, measure, report = SECTIONS[name]
        begin = time.perf_counter()
        out[name] = measure(arguments)
        out["seconds"][name] = time.perf_counter() - begin
        tables = report(out[name])
        parts.append(f"## {heading}\n\n{tables}")
        taken = f"({out['seconds'][name]:.0f} s)"
        print(tables if arguments.bare else f"\n{parts[-1]}\n\n{taken}", flush=True)
        write_content(path, json.dumps(out, indent=1))
        write_content(path.with_suffix(".md"), "\n\n".join(parts) + "\n")
    if not arguments.bare:
        print(f"\nTables: {path.with_suffix('.md')}; all numbers: {path}")


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument(
        "--only", nargs="+", choices=list(SECTIONS), default=list(SECTIONS), help="sections (default: all)"
    )
    p.add_argument("--seeds", type=int, nargs="+", default=[2], help="of the targets (default: 2)")
    p.add_argument("--kappa", type=float, nargs="+", default=[10.0, 1.0], help="default: 10 1")
    p.add_argument("--reach", type=int, default=100, help="targets of `reach` per seed (default: 100)")
    p.add_argument("--space", type=int, default=100, help="targets of `space` per set (default: 100)")
    p.add_argument("--targets", type=int, default=10, help="targets of `cost` per seed (default: 10)")
    p.add_argument("--fine", type=int, default=2, help="number of these on the plan's own grid (default: 2)")
    p.add_argument("--clear", type=int, default=40, help="targets of each satellite (default: 40)")
    p.add_argument(
        "--each", type=int, nargs=2, default=[12, 4], help="targets per kind, 3 and 7 joints (default: 12 4)"
    )
    p.add_argument("--plans", type=int, default=200, help="plans of `many` (default: 200)")
    p.add_argument("--bare", action="store_true", help="print tables alone, for docs/records.py")
    p.add_argument("--out", default="results/bench.json", help="file for all numbers; tables beside it")
    return p


def reach_section(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """Measure the reach for every kappa and seed."""
    sms = ffsms.load("planar_3r")
    return [reach(sms, kappa, seed, arguments.reach) for kappa in arguments.kappa for seed in arguments.seeds]


def cost_section(arguments: argparse.Namespace) -> list[dict[str, Any]] | str:
    """Compare the cost with that of IPOPT, or return the reason why it was not measured."""
    sms = ffsms.load("planar_3r")
    try:
        return [
            compare(sms, kappa, seed, arguments.targets, arguments.fine)
            for kappa in arguments.kappa
            for seed in arguments.seeds
        ]
    except ImportError as error:
        return f"IPOPT was not measured: not installed here ({error})."


def printed(show: Callable[[Any], None], results: Any) -> str:
    """Return the text that a function prints for results."""
    if isinstance(results, str):
        return results
    text = io.StringIO()
    with contextlib.redirect_stdout(text):
        show(results)
    return text.getvalue().strip()


def reach(sms: ffsms.SpaceManipulator, kappa: float, seed: int, count: int) -> dict[str, Any]:
    """Measure the library's plans, without IPOPT, on many targets."""
    return {"kappa": kappa, "seed": seed, "plans": run_plans(sms, paper_tasks(sms, count, seed), kappa)}


def compare(sms: ffsms.SpaceManipulator, kappa: float, seed: int, count: int, fine: int) -> dict[str, Any]:
    """Solve the same tasks by the planner and by the nonlinear program in each of its `FORMS`."""
    from ipopt import solve

    tasks = paper_tasks(sms, count, seed)
    result: dict[str, Any] = {"kappa": kappa, "seed": seed, "plans": run_plans(sms, tasks, kappa)}
    for name, (_, same_grid, expanded) in FORMS.items():
        rows = []
        for task in tasks[:fine] if same_grid else tasks:
            steps = round(task.duration / DT) if same_grid else COARSE
            found = solve(sms, task, kappa, steps, TIME_LIMIT, expanded)
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
    """Return the median of a column, NaN if it is empty."""
    return float(np.median([row[key] for row in rows])) if rows else float("nan")


def print_reach(results: list[dict[str, Any]]) -> None:
    """Print the reach: plans that keep all limits and clearances and meet const8."""
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
    """Print the library's and IPOPT's costs: medians over the same targets."""
    print(
        "\n| kappa | seed | planner | solved | median cost [s] | largest excess of `opt.plan` [s] | "
        "building [ms] | solving [ms] | ratio of total times | ratio of solving times | sign changes | "
        "integral of squared acceleration |"
    )
    print("|" + "---|" * 12)
    for r in results:
        plans = r["plans"]
        row_of("opt.plan", r, plans, plans)
        for name, (label, *_) in FORMS.items():
            if r[name]:
                row_of(label, r, r[name], plans[: len(r[name])])


def row_of(label: str, r: dict[str, Any], rows: list[dict[str, Any]], plans: list[dict[str, Any]]) -> None:
    """Print one row of the cost table; ratios are relative to the library's `plans` of the same targets."""
    ours = rows is plans
    done = sum(row["reached" if ours else "converged"] for row in rows)
    excess, building, both, solving = "", "", "", ""
    if not ours:
        pairs = list(zip(rows, plans, strict=True))
        worst = max((p["cost"] - row["cost"] for row, p in pairs if row["converged"]), default=float("nan"))
        excess, building = f"{worst:.4f}", f"{1e3 * median(rows, 'build_seconds'):.0f}"
        whole = [(row["seconds"] + row["build_seconds"]) / p["seconds"] for row, p in pairs]
        both = f"{np.median(whole):.0f}"
        solving = f"{np.median([row['seconds'] / p['seconds'] for row, p in pairs]):.0f}"
    print(
        f"| {r['kappa']:g} | {r['seed']} | {label} | {done} of {len(rows)} | "
        f"{median(rows, 'cost'):.5f} | {excess} | {building} | {1e3 * median(rows, 'seconds'):.0f} | "
        f"{both} | {solving} | {median(rows, 'sign_changes'):.0f} | "
        f"{median(rows, 'squared_acceleration'):.3f} |"
    )


SECTIONS: dict[str, Section] = {
    "startup": ("Start-up, whole processes", lambda _: startup.run(), table.startup),
    "state": ("A state and a control step, and their floors", lambda _: state_floor.run(), table.state),
    "step": ("A planning step and its floor", lambda _: step_floor.run(), step_floor.report),
    "peers": ("Other libraries", lambda _: peers.run(), table.peers),
    "sizes": ("Growth with joints and duration", lambda _: sizes.run(), table.sizes),
    "many": ("Many plans in several processes", lambda a: many.run(a.plans), table.many),
    "reach": ("Reach of the planner", reach_section, lambda found: printed(print_reach, found)),
    "space": (
        "Reach of the planner in space",
        lambda a: space.run(a.space, a.seeds[0]),
        space.report,
    ),
    "clear": (
        "Plans reported clear, checked on the meshes",
        lambda a: clearances.run(a.clear, a.seeds[0]),
        clearances.report,
    ),
    "strategies": (
        "Effect of each strategy of the search",
        lambda a: strategies.run(tuple(a.each), a.seeds[0]),
        strategies.report,
    ),
    "cost": ("The plan compared with IPOPT", cost_section, lambda found: printed(print_costs, found)),
}


if __name__ == "__main__":
    main()
