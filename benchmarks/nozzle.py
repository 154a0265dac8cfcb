"""Simulate the packaged `nozzle` with other plants and other noise; print latches, loads and times.

Run from the repository's root:
    python benchmarks/nozzle.py [--seeds 100] [--first 0] [--mujoco] [--resume FILE]
With `--resume` each run is a line of that file. Runs in the file are not repeated, but are in the table. A
seed draws the plant's masses and inertias, and the noise of sensors and camera; everything else is as
packaged except the time after the catch. For each run without a latch, the reason is printed. CPU times are
those of planning before the flight, of all re-plans, and of the whole run. With `--mujoco` each catch is
repeated in MuJoCo, see nozzle_in_mujoco.py.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from nozzle_in_mujoco import rates_off
from table import markdown

from ffsms_pin import scenarios
from ffsms_pin.errors import FfsmsError
from ffsms_pin.opt.replan.rest import RestPlanner
from ffsms_pin.scenarios import closed_loop
from ffsms_pin.scenarios.definition import packaged_path

WORDS = {
    "guide": "largest force across the rod, in the guide [N]",
    "force": "largest force [N]",
    "share": "largest joint torque, share of its limit",
    "above": "share of the time above the limit",
    "limited": "share of the time at the limit",
    "planning": "CPU time of planning [s]",
    "replanning": "CPU time of re-planning [s]",
    "cpu": "CPU time of the whole run [s]",
    "off": "final rates, relative difference to MuJoCo",
}

ASKED = {"guide": 20.0, "share": 1.0, "planning": 5.0, "replanning": 5.0, "off": 0.01}  # upper bounds


def timed(owner: Any, name: str, spent: list[float]) -> None:
    """Replace `owner.name` by a function that appends its CPU time [s] to `spent`."""
    function: Callable[..., Any] = getattr(owner, name)

    def wrapped(*arguments: Any, **options: Any) -> Any:
        began = time.process_time()
        try:
            return function(*arguments, **options)
        finally:
            spent.append(time.process_time() - began)

    setattr(owner, name, wrapped)


PLANNING: list[float] = []
REPLANNING: list[float] = []


def flown(seed: int, mujoco: bool) -> dict[str, Any]:
    """Simulate one seed, and return its numbers."""
    text = re.sub(r"(?m)^after = .*$", "after = 2.0", packaged_path("nozzle").read_text("utf-8"))
    text = text.replace("[plant.random]\nseed = 1", f"[plant.random]\nseed = {seed}")
    for table in ("[client.sensor]", "[sensors]"):
        text = text.replace(table, f"{table}\nseed = {seed}")
    PLANNING.clear()
    REPLANNING.clear()
    began = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "nozzle.toml"
        path.write_text(text, encoding="utf-8")
        try:
            outcome = scenarios.run(scenarios.scenario(path))
        except FfsmsError as error:
            return {"caught": False, "why": str(error)}
    spent = time.process_time() - began
    found = outcome.capture
    assert found is not None
    whole = found.whole
    forces = whole.contact_wrench[whole.t < found.latched_at - 1e-6, :3]
    sizes, across = np.linalg.norm(forces, axis=1), np.zeros(len(forces))
    for k in np.flatnonzero((sizes > 0.0) & (whole.t[: len(forces)] < found.contact_at - 1e-6)):
        rod = outcome.sms.at(whole.q[k]).end_effector_pose.rotation[:, 2]
        across[k] = np.linalg.norm(forces[k] - (forces[k] @ rod) * rod)
    shares = np.abs(whole.tau) / found.sms.limits.torque
    return {
        "caught": found.caught,
        "why": found.missed,
        "guide": float(across.max()),
        "force": float(sizes.max()),
        "share": float(shares.max()),
        "above": float((shares > 1.0 + 1e-9).any(axis=1).mean()),
        "limited": float((shares > 1.0 - 1e-9).any(axis=1).mean()),
        "planning": sum(PLANNING),
        "replanning": sum(REPLANNING),
        "cpu": spent,
        "off": rates_off(outcome) if mujoco and found.caught else np.nan,
    }


def main() -> None:
    """Print a line for each run as it ends, and a Markdown table of all runs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--mujoco", action="store_true")
    parser.add_argument("--resume", type=Path, help="file of the runs so far")
    arguments = parser.parse_args()
    timed(closed_loop, "planned", PLANNING)
    timed(RestPlanner, "plan", REPLANNING)
    # Skip the simulation of the first plan without re-planning.
    mock.patch.object(closed_loop, "attempt", return_value=None).start()
    kept = arguments.resume
    lines = kept.read_text("utf-8").splitlines() if kept is not None and kept.exists() else []
    rows = [json.loads(line) for line in lines]
    flown_before = {row["seed"] for row in rows}
    for seed in set(range(arguments.first, arguments.first + arguments.seeds)) - flown_before:
        rows.append(row := {"seed": seed, **flown(seed, arguments.mujoco)})
        if kept is not None:
            with kept.open("a", encoding="utf-8") as file:
                file.write(f"{json.dumps(row)}\n")
        what = "latched" if row["caught"] else row["why"]
        numbers = [f"{words} {row[name]:.3g}" for name, words in WORDS.items() if name in row]
        print(f"{seed}: {what}; {', '.join(numbers)}", file=sys.stderr, flush=True)
    print(f"{sum(row['caught'] for row in rows)} of {len(rows)} latched.\n")
    missed = [f"* seed {row['seed']}: {row['why'][:200]}\n" for row in rows if not row["caught"]]
    if missed:
        print(f"Not latched:\n\n{''.join(missed)}")
    table = []
    for name, words in WORDS.items():
        values = [row[name] for row in rows if np.isfinite(row.get(name, np.nan))]
        if values:
            middle, high, most = (f"{value:.2g}" for value in np.percentile(values, (50, 95, 100)))
            asked = ASKED.get(name)
            beyond = "" if asked is None else f"{sum(value > asked for value in values)} above {asked:g}"
            table.append((words, str(len(values)), middle, high, most, beyond))
    print(markdown(("", "runs", "median", "95 %", "max", "above the bound"), table))


if __name__ == "__main__":
    main()
