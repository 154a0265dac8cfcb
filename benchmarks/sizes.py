"""Measure times against the number of joints, and time and memory against the length of a simulation."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from typing import Any

import numpy as np
import state_floor
import table
from chains import chain, robot
from targets import reachable_targets
from timing import in_turns

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.simulation.integrators import rk4_step

JOINTS = (3, 6, 7, 14, 30)
PLANNED = (3, 6, 7)
PLANS = 3  # number of targets per number of joints
STATES, STEP, DT = 10, 0.01, 1e-3  # number of states, [s] planning step, [s] control step


def run(turns: int = 40, hour: bool = True) -> dict[str, Any]:
    """Return times for several numbers of joints and durations."""
    rows = [joints(n, turns) for n in JOINTS]
    what = ("state", "planning step", "control step")
    exponents = {name: exponent([(row["joints"], row[name]["median"]) for row in rows]) for name in what}
    two_arms = joints(14, turns, packaged=True)
    return {
        "joints": rows,
        "two_arms": two_arms,
        "exponents": exponents,
        "plans": [planned(n) for n in PLANNED],
        "durations": durations((1.0, 60.0, 600.0, 3600.0) if hour else (1.0, 60.0, 600.0)),
    }


def joints(n: int, turns: int, packaged: bool = False) -> dict[str, Any]:
    """Time a state with all quantities, a planning step and a control step of a chain of n joints."""
    sms = robot(n) if packaged else chain(n)
    rng = np.random.default_rng(n)
    q0 = sms.configuration(np.full(n, 0.3))
    target = sms.at(sms.configuration(np.full(n, 0.45))).end_effector_pose.translation
    plan = opt.plan(sms, q0, target, 6.0, STEP, method="step")
    middle = slice(100, 100 + STATES)
    planner, rates, q = opt.StepPlanner(sms, STEP), plan.joint_rates[middle], plan.q[middle]
    v = plan.v[middle] + 1e-2 * rng.normal(size=(STATES, sms.nv))
    law = ffsms.SlidingModeController(sms)
    data, force, rest = sms.model.createData(), np.zeros(sms.nv), np.zeros(n)

    def state(i: int) -> None:
        found = sms.at(q[i], v[i])
        _ = found.coupling.U, found.coupling.sigma, found.coupling.V, found.coupling.entropy
        for name in state_floor.QUANTITIES:
            getattr(found, name)

    def control(i: int) -> None:
        force[6:] = law.torque(q[i], v[i], q0[7:], rest, rest)
        rk4_step(sms.model, data, q[i], v[i], force, DT)

    found = in_turns(
        {
            "state": state,
            "planning step": lambda i: planner.step(q[i], rates[i], target, 6.0 - plan.t[100 + i]),
            "control step": control,
        },
        turns,
        STATES,
    )
    return {"joints": n, "robot": sms.model.name, **found}


def exponent(points: list[tuple[int, float]]) -> dict[str, float]:
    """Return slopes of log time over log joints: a fit to all sizes, and between the two largest sizes."""
    n, t = np.log([point[0] for point in points]), np.log([point[1] for point in points])
    return {
        "fitted": float(np.polyfit(n, t, 1)[0]),
        "last": float((t[-1] - t[-2]) / (n[-1] - n[-2])),
    }


def planned(n: int) -> dict[str, Any]:
    """Time `opt.plan` for targets that are reachable by construction."""
    sms = robot(n)
    tasks = reachable_targets(sms, np.full(n, np.deg2rad(5.0)), PLANS, 1, STEP)
    opt.plan(sms, tasks[0].q0, tasks[0].target, tasks[0].duration, STEP)
    rows = []
    for task in tasks:
        begin = time.perf_counter()
        plan = opt.plan(sms, task.q0, task.target, task.duration, STEP)
        rows.append((time.perf_counter() - begin, plan.reached, task.duration))
    seconds = [row[0] for row in rows]
    return {
        "joints": n,
        "robot": sms.model.name,
        "seconds": {"median": float(np.median(seconds)), "least": min(seconds), "most": max(seconds)},
        "reached": sum(row[1] for row in rows),
        "plans": PLANS,
    }


# Only the recording grows, because the joints swing with constant amplitude. Each run has its own process, so
# that its memory can be measured.
SIMULATION = """
import json, sys, time, numpy as np, resource
import ffsms_pin as ffsms
duration, dt = float(sys.argv[1]), float(sys.argv[2])
sms = ffsms.load("planar_3r")

class Sway:
    def __init__(self, duration):
        self.duration, self.target = duration, np.array([0.5, 0.5, 0.0])
        self.q = sms.configuration(np.zeros(3))[None]
    def sample(self, t):
        s, c = np.sin(0.5 * t), np.cos(0.5 * t)
        return np.full(3, 0.2 * s), np.full(3, 0.1 * c), np.full(3, -0.05 * s)

law = ffsms.SlidingModeController(sms)

def taken():  # [MB] anonymous memory, without mapped files
    lines = open("/proc/self/status").read().split("\\n")
    return sum(int(line.split()[1]) for line in lines if line.startswith("RssAnon")) / 1024

ffsms.simulate(sms, Sway(50 * dt), law, dt)
before, most = taken(), 0.0
def watch(share):
    global most
    most = max(most, taken())
begin = time.perf_counter()
run = ffsms.simulate(sms, Sway(duration), law, dt, progress=watch)
seconds = time.perf_counter() - begin
watch(1.0)
print(json.dumps({
    "seconds": seconds, "steps": len(run.tau), "memory_MB": most - before,
    "bytes_a_step": sum(a.nbytes for a in vars(run).values() if isinstance(a, np.ndarray)) / len(run.tau),
    "joint_error": float(np.abs(run.joint_error).max()),
    "momentum": float(np.abs(run.momentum).max()),
}))
"""


def durations(lengths: tuple[float, ...], dt: float = 0.01) -> list[dict[str, Any]]:
    """Simulate each duration [s] at a control step of 10 ms."""
    rows = []
    for length in lengths:
        command = [sys.executable, "-c", SIMULATION, str(length), str(dt)]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        rows.append({"duration": length, "dt": dt, **json.loads(done.stdout)})
    return rows


if __name__ == "__main__":
    print(table.sizes(run()))
