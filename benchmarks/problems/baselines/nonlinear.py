"""Solve the whole motion as a nonlinear program by CasADi and IPOPT, for positions of the planar arm only.

`benchmarks/ipopt.py` has the program: the planar arm in closed form, the paper's cost, no clearances. IPOPT
starts from the straight joint move that the pseudo-inverse of the generalised Jacobian finds.
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.problems.baselines.library import robot
from benchmarks.problems.baselines.rrt import Planner
from benchmarks.problems.judge import KAPPA, Problem, pin, se3

STEPS = 100


def planned(problem: Problem, seconds: float) -> dict[str, Any] | None:
    """Return a plan for a position of the planar arm at rest, otherwise None."""
    if problem["robot"] != "planar_3r" or np.any(problem["momentum"]) or problem["limits"]["base_attitude"]:
        return None
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
    ipopt, targets = (importlib.import_module(name) for name in ("ipopt", "targets"))
    planner = Planner(problem)
    planner.clearance = -np.inf  # the nonlinear program has no clearances
    path = planner.path(np.inf)
    assert path is not None
    q0, place = planner.world.q0, problem["goals"][0]["position"]
    com = pin.centerOfMass(planner.world.model, planner.world.data, q0)
    # The program's inertial frame is at the centre of mass, with the base's axes at the start.
    target = se3(problem["start"]).rotation.T @ (np.array(place) - com)
    sms = robot(problem["robot"], problem["goals"][0]["frame"], tuple(problem["limits"]["acceleration"]))
    task = targets.Task(q0, target, problem["duration"], path[-1], None)
    found = ipopt.solve(sms, task, KAPPA, STEPS, 0.8 * seconds)
    t = np.linspace(0.0, problem["duration"], STEPS + 1)
    travel = 0.5 * (found.rates[1:] + found.rates[:-1]) * np.diff(t)[:, None]
    joints = q0[7:] + np.vstack([np.zeros(3), np.cumsum(travel, axis=0)])
    return {"t": t, "joints": joints, "rates": found.rates, "note": found.status}
