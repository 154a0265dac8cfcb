"""Draw targets that are reachable by construction.

A joint goal is drawn from 90 % of the joint box. If the straight joint-space move to it keeps the clearances
that `opt.plan` keeps by default, the target is the position (or pose) of the end effector at its end, with a
floating base. The duration is 1.5 times the minimum time of the slowest joint, so the straight move is a
solution. Clearances are those by which `opt.Clearance` checks finished motions: between the bodies'
collision shapes, and between the paper's points (const4 to const7) for planar arms and bodies without shapes.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.rollouts import rolled_out
from ffsms_pin.robot.base_motion import roll_out
from ffsms_pin.system.batch.arm import ArmStack

CLEARANCE = 0.01  # [m]
SHARE = 0.9  # share of the joint box
SLACK = 1.5  # durations as multiples of the joints' minimum time
STEPS = 120  # number of steps of the straight move, for its clearances and the base's reaction


class Task(NamedTuple):
    """A start, a target, a duration, the joint goal that defines the target, and its pose (pinocchio.SE3)."""

    q0: FloatArray
    target: FloatArray
    duration: float
    joint_goal: FloatArray
    pose: Any


def reachable_targets(
    sms: ffsms.SpaceManipulator, start: FloatArray, count: int, seed: int, dt: float
) -> list[Task]:
    """Draw `count` tasks from joint positions `start` (n,); durations are whole numbers of steps `dt`."""
    rng, limits, stack = np.random.default_rng(seed), sms.limits, ArmStack(sms)
    clearance = opt.Clearance(CLEARANCE).for_robot(sms)
    low = np.where(np.isfinite(limits.lower), limits.lower, -math.pi)
    high = np.where(np.isfinite(limits.upper), limits.upper, math.pi)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    q0 = sms.configuration(start)
    tasks: list[Task] = []
    while len(tasks) < count:
        joint_goal = middle + SHARE * half * rng.uniform(-1.0, 1.0, sms.n)
        move = joint_goal - start
        # One second at constant rates: the base's motion depends on the path alone, not on its timing.
        rates, dt_move = np.tile(move, (STEPS + 1, 1)), 1.0 / STEPS
        motion = rolled_out(sms, stack, q0, rates, dt_move)
        if clearance.violation(motion).amount > 0.0:
            continue
        # This simple integration keeps the targets of each seed unchanged.
        q, _ = roll_out(sms, q0, move, np.zeros((STEPS, sms.n)), dt_move)
        least = np.max(np.abs(move) / limits.velocity + limits.velocity / limits.acceleration)
        duration = dt * math.ceil(SLACK * float(least) / dt - 1e-9)
        pose = sms.at(q[-1]).end_effector_pose
        tasks.append(Task(q0, pose.translation.copy(), duration, joint_goal, pose))
    return tasks
