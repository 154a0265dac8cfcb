"""Count the targets that are reached under base limits, and measure the cost of the plans.

Run from the repository's root: python benchmarks/base_limits.py [--targets 24]
The targets are reachable by construction (see `targets`) if the base rotates freely. Base limits are checked
independently of the planner: the momentum equation is integrated in twenty substeps per step.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from targets import STEPS, Task, reachable_targets

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.robot.base_motion import roll_out

DT = 0.01  # [s]
SUBSTEPS = 20
ROBOTS = ("satellite_panda", "satellite_xarm7")
DEGREE = np.pi / 180.0
LIMITS = {
    "none": None,
    "attitude 2 deg": opt.BaseLimits(attitude=2.0 * DEGREE),
    "attitude 0.5 deg": opt.BaseLimits(attitude=0.5 * DEGREE),
    "final attitude 0.2 deg": opt.BaseLimits(final_attitude=0.2 * DEGREE),
}


def start_of(sms: ffsms.SpaceManipulator) -> FloatArray:
    """Return start positions (n,) away from the middle of the joint box, where many arms are singular."""
    low = np.where(np.isfinite(sms.limits.lower), sms.limits.lower, -np.pi)
    high = np.where(np.isfinite(sms.limits.upper), sms.limits.upper, np.pi)
    share = np.resize([0.03, -0.04, 0.02, 0.01, 0.05, 0.02, 0.01], sms.n)
    return np.asarray(0.5 * (low + high) + share * (high - low))


def pose_of(sms: ffsms.SpaceManipulator, task: Task) -> Any:
    """Return the pose at the end of the straight joint move that defines a target."""
    move = task.joint_goal - sms.layout.positions(task.q0)
    q, _ = roll_out(sms, task.q0, move, np.zeros((STEPS, sms.n)), 1.0 / STEPS)
    return sms.at(q[-1]).end_effector_pose


def turns(sms: ffsms.SpaceManipulator, plan: opt.Trajectory) -> FloatArray:
    """Return the base rotation from the start [rad], integrated at the nodes and between them."""
    accelerations = np.repeat(plan.joint_accelerations, SUBSTEPS, axis=0)
    q, _ = roll_out(sms, plan.q[0], plan.joint_rates[0], accelerations, plan.dt / SUBSTEPS)
    first = pin.XYZQUATToSE3(q[0, :7]).rotation.T
    return np.array([np.linalg.norm(pin.log3(first @ pin.XYZQUATToSE3(row[:7]).rotation)) for row in q])


def measured(
    sms: ffsms.SpaceManipulator, tasks: list[Task], posed: bool, limits: opt.BaseLimits | None
) -> list[dict[str, float]]:
    """Plan each task under base limits, and return one row for each."""
    rows = []
    for task in tasks:
        target = pose_of(sms, task) if posed else task.target
        begin = time.process_time()
        plan = opt.plan(sms, task.q0, target, task.duration, DT, base_limits=limits)
        seconds = time.process_time() - begin
        turned = turns(sms, plan)
        kept = limits is None or bool(turned.max() <= limits.attitude and turned[-1] <= limits.final_attitude)
        rows.append(
            {
                "reached": plan.reached,
                "kept": kept,
                "cost": plan.cost_integral,
                "most": turned.max() / DEGREE,
                "last": turned[-1] / DEGREE,
                "seconds": seconds,
            }
        )
    return rows


def line(robot: str, kind: str, name: str, rows: list[dict[str, float]]) -> str:
    """Return one line of the table; medians and maxima are over the plans that reach their targets."""
    good = [row for row in rows if row["reached"]]
    most, last, cost = ([row[key] for row in good] for key in ("most", "last", "cost"))
    cells = [
        robot,
        kind,
        name,
        f"{len(good)} of {len(rows)}",
        f"{sum(bool(row['kept']) for row in rows)} of {len(rows)}",
        f"{np.median(most):.2f} / {max(most):.2f}" if good else "-",
        f"{np.median(last):.2f} / {max(last):.2f}" if good else "-",
        f"{np.median(cost):.4f}" if good else "-",
        f"{np.median([row['seconds'] for row in rows]):.2f}",
    ]
    return f"| {' | '.join(cells)} |"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a Markdown table with a line for each robot, kind of target and limit."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--targets", type=int, default=24)
    parser.add_argument("--seed", type=int, default=31)
    parser.add_argument("--robots", nargs="+", default=ROBOTS)
    parser.add_argument("--limits", nargs="+", choices=list(LIMITS), default=list(LIMITS))
    parser.add_argument("--kinds", nargs="+", choices=("position", "pose"), default=("position", "pose"))
    given = parser.parse_args(arguments)
    print(
        "| robot | target | base limit | reached | limit satisfied "
        "| largest base rotation, median / max [deg] | final base rotation, median / max [deg] "
        "| median cost [s] | median CPU time [s] |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for robot in given.robots:
        sms = ffsms.load(robot)
        tasks = reachable_targets(sms, start_of(sms), given.targets, given.seed, DT)
        for kind in given.kinds:
            for name in given.limits:
                rows = measured(sms, tasks, kind == "pose", LIMITS[name])
                print(line(robot, kind, name, rows), flush=True)


if __name__ == "__main__":
    main()
