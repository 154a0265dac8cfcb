"""Run all solvers on the problem set.

Run: python -m benchmarks.problems --solvers ours resolved-rate
Each result is appended to a file; results in the file are not computed again. The table has the number of
problems of each family that are solved, according to the judge, within a limit of CPU time.
"""

from __future__ import annotations

import argparse
import datetime
import importlib
import json
import signal
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.problems.judge import FAMILIES, Problem, judge, load

# The module of a solver, and its arguments besides the problem and the time.
SOLVERS: dict[str, tuple[str, dict[str, Any]]] = {
    "ours": ("library", {}),
    "step": ("library", {"method": "step"}),
    "resolved-rate": ("library", {"method": "resolved-rate"}),
    "null-space": ("null_space", {}),
    "rrt": ("rrt", {}),
    "ipopt": ("nonlinear", {}),
    "crocoddyl": ("crocoddyl_ddp", {}),
}
# The solver to whose costs, joint travels and base rotations those of the others are relative.
BESIDE = "resolved-rate"


class OutOfTime(BaseException):
    """Raised if a solver exceeds its CPU time; a BaseException, so that no solver catches it."""


def run(solver: str, problem: Problem, seconds: float) -> dict[str, Any]:
    """Return one row: the judge's numbers of a plan, its CPU time [s], and the solver's own verdict."""
    module, options = SOLVERS[solver]
    plan = importlib.import_module(f"benchmarks.problems.baselines.{module}").planned
    row: dict[str, Any] = {"solver": solver, "problem": problem["name"], "robot": problem["robot"]}

    def stop(*_: Any) -> None:
        raise OutOfTime

    signal.signal(signal.SIGVTALRM, stop)
    begin, solution = time.process_time(), None
    try:
        signal.setitimer(signal.ITIMER_VIRTUAL, seconds)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            solution = plan(problem, seconds, **options)
        row["applies"] = solution is not None
    except OutOfTime:
        row |= {"applies": True, "note": f"stopped after {seconds:g} s"}
    except Exception as error:  # a solver that fails has not solved the problem
        row |= {"applies": True, "note": f"{type(error).__name__}: {error}"}
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
    row["seconds"] = time.process_time() - begin
    if solution is not None:
        row |= {key: solution[key] for key in ("claimed", "note") if key in solution}
        row |= judge(problem, solution)
    return {"solved": False, "exact": False, **row}


def family(row: dict[str, Any]) -> str:
    """Return the family of a row's problem."""
    return str(row["problem"].rpartition("-")[0])


def share(rows: list[dict[str, Any]]) -> str:
    """Return the number of solved problems, n/a if the solver does not apply, "" if it was not run."""
    count = sum(row["applies"] for row in rows)
    return f"{sum(row['solved'] for row in rows)} of {count}" if count else "n/a" if rows else ""


def table(rows: list[dict[str, Any]]) -> str:
    """Return a Markdown table with a line for each solver."""
    columns = ("all", "exact", "limit violated", "cost", "travel", "base rotation", "CPU [s]")
    head = ["solver", *FAMILIES, *columns]
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    beside = {row["problem"]: row for row in rows if row["solver"] == BESIDE and row["solved"]}
    for solver in SOLVERS:
        mine = [row for row in rows if row["solver"] == solver]
        asked = [row for row in mine if row["applies"]]
        if not asked:
            continue
        cells = [solver]
        cells += [share([row for row in mine if family(row) == one]) for one in FAMILIES] + [share(mine)]
        cells.append(str(sum(row["exact"] for row in asked)))
        cells.append(str(sum(bool(row.get("broken")) for row in asked)))
        both = [(row, beside[row["problem"]]) for row in asked if row["solved"] and row["problem"] in beside]
        for key in ("cost", "travel", "base_turn"):
            ratios = [one[key] / other[key] for one, other in both if other[key] > 1e-6]
            cells.append(f"{np.median(ratios):.2g}" if ratios else "")
        half, most = np.percentile([row["seconds"] for row in asked], [50, 90])
        cells.append(f"{half:.2g}, {most:.2g}")
        lines.append(f"| {' | '.join(cells)} |")
    claimed = [row for row in rows if row.get("claimed")]
    sure = [row for row in claimed if row["claimed"]["kept"] is not None]
    if claimed:
        agree = sum(
            row["claimed"] == {"reached": row["solved"], "exact": row["exact"], "kept": not row["broken"]}
            for row in sure
        )
        lines.append(
            f"\nThe library and the judge agree on {agree} of {len(sure)} plans: reached, exact, limits kept."
            f" For {len(claimed) - len(sure)} more, the library could not prove the clearance between"
            " instants."
        )
    return "\n".join(lines)


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.problems", description=__doc__)
    parser.add_argument("--solvers", nargs="+", choices=SOLVERS, default=list(SOLVERS), help="default: all")
    parser.add_argument("--families", nargs="+", choices=FAMILIES, default=FAMILIES, help="default: all")
    parser.add_argument("--limit", type=int, help="problems of each family (default: all)")
    parser.add_argument("--seconds", type=float, default=30.0, help="CPU time per problem [s] (default: 30)")
    parser.add_argument("--out", type=Path, default=Path("results/problems.jsonl"), help="file for the rows")
    parser.add_argument("--table", action="store_true", help="print only the table of the existing rows")
    given = parser.parse_args()
    given.out.parent.mkdir(parents=True, exist_ok=True)
    known = given.out.read_text("utf-8").splitlines() if given.out.exists() else []
    rows = [json.loads(line) for line in known]
    done = {(row["solver"], row["problem"]) for row in rows}
    problems = [one for name in given.families for one in load(name)[: given.limit]]
    # Solvers take turns, so that the finished part of a stopped run is a fair sample.
    problems.sort(key=lambda one: int(one["name"][-3:]))
    with open(given.out, "a", encoding="utf-8") as file:
        for solver in [] if given.table else given.solvers:
            try:
                importlib.import_module(f"benchmarks.problems.baselines.{SOLVERS[solver][0]}")
            except ImportError as error:
                print(f"{solver}: not measured, {error}", file=sys.stderr)
                continue
            for i, problem in enumerate(problems):
                if (solver, problem["name"]) in done:
                    continue
                rows.append(run(solver, problem, given.seconds))
                file.write(json.dumps(rows[-1]) + "\n")
                file.flush()
                print(f"\r{solver}: {i + 1} of {len(problems)}", end="", file=sys.stderr, flush=True)
            print(file=sys.stderr)
    text = table(rows)
    print(text)
    given.out.with_suffix(".md").write_text(text + "\n", encoding="utf-8")
    about = {"date": datetime.date.today().isoformat(), "seconds": given.seconds, "machine": machine()}
    given.out.with_suffix(".json").write_text(json.dumps(about, indent=1), encoding="utf-8")


def machine() -> dict[str, Any]:
    """Return processor, cores and versions."""
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
    facts: Callable[[], dict[str, Any]] = importlib.import_module("machine").facts
    return facts()


if __name__ == "__main__":
    main()
