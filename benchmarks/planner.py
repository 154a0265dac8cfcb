"""Measure reached targets, cost and time of `opt.plan`; all targets are reachable by construction."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from clearances import Meshes
from targets import CLEARANCE, Task, reachable_targets

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.geometry.bodies import PointStack, chosen_mode

DT = 0.01  # [s]

# A function that returns whether the clearance is kept at joint positions (n,).
Apart: TypeAlias = Callable[[FloatArray], bool]


def paper_tasks(sms: ffsms.SpaceManipulator, count: int, seed: int) -> list[Task]:
    """Return tasks that begin at the paper's initial configuration."""
    return reachable_targets(sms, np.full(sms.n, np.deg2rad(1.0)), count, seed, DT)


def bent(sms: ffsms.SpaceManipulator) -> FloatArray:
    """Return start positions (n,): the middle of the joint box, bent if the arm is stretched there.

    The boxes of `satellite_panda` and `satellite_xarm7` have bent middles; that of `space_arm_7` is zero.
    """
    limits = sms.limits
    middle = 0.5 * (limits.lower + limits.upper)
    return np.where(np.arange(sms.n) % 2 == 1, 0.6, 0.0) if not middle.any() else middle


def smoothness(rates: FloatArray, dt: float) -> dict[str, float]:
    """Count sign changes of the joint rates, and integrate the squared accelerations [rad^2/s^3]."""
    changes = int(np.sum(rates[1:-1] * rates[2:] < -1e-8))
    return {"sign_changes": changes, "squared_acceleration": float(np.sum(np.diff(rates, axis=0) ** 2) / dt)}


def apart_by(sms: ffsms.SpaceManipulator) -> Apart:
    """Return a function that checks the default clearances of `opt.plan`, by meshes or the paper's points.

    The planner itself checks convex parts, which are slightly larger than the meshes.
    """
    if chosen_mode(sms) == "points":
        points = PointStack(sms)
        return lambda joints: bool(
            points.values(points.at(sms.configuration(joints), 0.0)).min() >= CLEARANCE
        )
    meshes = Meshes(sms)
    return lambda joints: not meshes.collide(joints, near=True)


def limits_kept(sms: ffsms.SpaceManipulator, plan: opt.Trajectory, apart: Apart) -> bool:
    """Return whether limits and clearances are kept at and between nodes, without the planner's code."""
    limits = sms.limits
    if (np.abs(plan.joint_rates) > limits.velocity + 1e-9).any():
        return False
    if (np.abs(plan.joint_accelerations) > limits.acceleration + 1e-9).any():
        return False
    h = np.array([0.0, 0.25, 0.5, 0.75])[:, None, None] * plan.dt
    places = plan.joint_positions[:-1] + h * (plan.joint_rates[:-1] + 0.5 * h * plan.joint_accelerations)
    if limits.violation(places.reshape(-1, sms.n)).max() > 1e-9:
        return False
    return all(apart(row) for row in places[::2, ::5].reshape(-1, sms.n))


def run_plans(
    sms: ffsms.SpaceManipulator, tasks: list[Task], kappa: float, poses: bool = False
) -> list[dict[str, Any]]:
    """Return one row for each task; with `poses`, the attitude is part of the target."""
    apart, rows = apart_by(sms), []
    opt.plan(sms, tasks[0].q0, tasks[0].target, tasks[0].duration, DT, kappa)  # first use fills caches
    for task in tasks:
        begin = time.process_time()
        plan = opt.plan(sms, task.q0, task.pose if poses else task.target, task.duration, DT, kappa)
        seconds = time.process_time() - begin
        rows.append(
            {
                "reached": plan.reached and limits_kept(sms, plan, apart),
                "cost": plan.cost_integral,
                "seconds": seconds,
                "end_error": float(plan.position_error[-1]),
                "end_angle": float(plan.orientation_error[-1]),
                "note": plan.note,
                **smoothness(plan.joint_rates, plan.dt),
            }
        )
    return rows
