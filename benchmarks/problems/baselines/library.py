"""Plan by this library, the whole motion at once or step by step."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np

import ffsms_pin as ffsms
from benchmarks.problems.judge import HERE, SHAPES, Problem, se3
from ffsms_pin import opt
from ffsms_pin.opt.plans import plan_problem

STEPS = 500  # number of steps of a plan


@lru_cache
def robot(name: str, frame: str, acceleration: tuple[float, ...]) -> ffsms.SpaceManipulator:
    """Return a robot of the set from its files."""
    return ffsms.load(HERE / "robots" / f"{name}.urdf", end_effector=frame, acceleration=acceleration)


def stated(problem: Problem) -> opt.Problem:
    """Return a problem of the set as a `Problem` of the library."""
    limits, goals = problem["limits"], problem["goals"]
    sms = robot(problem["robot"], goals[0]["frame"], tuple(limits["acceleration"]))
    q0 = sms.configuration(problem["start"]["joints"], base=se3(problem["start"]))
    given, client = problem["client"], None
    if given:
        client = ffsms.Client(given["mass"], given["inertia"], se3(given), given["twist"])
    around = [
        opt.Obstacle(
            SHAPES[one["shape"]](*one["size"]), se3(one), client if one["on"] == "client" else "inertial"
        )
        for one in problem["obstacles"]
    ]
    kept: list[opt.Limit] = [opt.JointLimits(), opt.TorqueLimits()]
    kept.append(opt.Clearance(limits["clearance"], "hulls", obstacles=around))
    base = {key: limits[f"base_{key}"] or math.inf for key in ("attitude", "translation")}
    kept += [opt.BaseLimits(**base)] if min(base.values()) < math.inf else []
    kept += [opt.FrameGoal(goal["frame"], _goal(goal, client)) for goal in goals[1:]]
    momentum = np.array(problem["momentum"])
    duration = problem["duration"]
    return opt.Problem(
        sms, q0, _goal(goals[0], client), duration, duration / STEPS, limits=kept, momentum=momentum
    )


def _goal(goal: dict[str, Any], client: ffsms.Client | None) -> opt.Goal:
    near = {"reach": goal["reach"], "tolerance": goal["tolerance"] or opt.Position.tolerance}
    turn = {"orientation_reach": goal["orientation_reach"]}
    if goal["on"] == "client":
        return opt.Meet(client, se3(goal), standoff=0.0, **near, **turn)
    return (
        opt.Position(goal["position"], **near)
        if goal["quaternion"] is None
        else opt.Pose(se3(goal), **near, **turn)
    )


def planned(problem: Problem, seconds: float, method: str = "horizon") -> dict[str, Any] | None:
    """Return a plan by one of the library's methods, with its own verdict; None if no method applies."""
    if method != "horizon" and problem["client"]:
        return None
    plan = plan_problem(stated(problem), method, opt.SearchOptions(time_limit=0.8 * seconds))
    claimed: dict[str, bool | None] = {
        "reached": plan.reached,
        "exact": plan.reached and plan.within_tolerance,
    }
    # The judge does not count goals as limits. A clearance that is not proven may still be kept.
    unsure = "a clearance is not proven" in plan.note
    claimed["kept"] = None if unsure else all(name.startswith("also ") for name in plan.broken)
    return {
        "t": plan.t,
        "joints": plan.joint_positions,
        "rates": plan.joint_rates,
        "claimed": claimed,
        "note": plan.note,
    }
