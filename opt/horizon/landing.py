"""What a landing must aim at so that the rolled-out plan does what the task asks.

The descent sees the motion at the points of a quadrature; the plan is rolled out at its nodes. Where the two
differ, by a millimetre at a long arm's end or by a corner of the base between two points, the descent is
given another aim: beside the target by as much as the plan missed it, and further off what the plan came too
near to.
"""

from __future__ import annotations

from dataclasses import replace

from ffsms_pin.opt.horizon.motion import least_clearance, nodes_and_middles
from ffsms_pin.opt.horizon.rounds import ARRIVAL
from ffsms_pin.opt.horizon.task import Task
from ffsms_pin.opt.trajectory import Trajectory

__all__ = ["corrected"]

_SPARE = 1e-4  # [arm lengths] further off than the clearance that lacked


def corrected(task: Task, aim: Task, plan: Trajectory) -> Task | None:
    """The next aim, after a landing at `aim` gave this plan; None where the plan does what `task` asks."""
    error = max(float(plan.position_error[-1]), float(plan.orientation_error[-1]))
    if plan.reached and error <= ARRIVAL:
        return None
    goal = aim.goal + task.rotation0.T @ (task.target - plan.end_effector[-1])
    rotation, clearance = aim.rotation, aim.clearance
    if task.rotation is not None and rotation is not None:
        turned = task.sms.at(plan.q[-1]).end_effector_pose.rotation
        rotation = task.rotation @ turned.T @ rotation
    if not plan.clear:
        places = nodes_and_middles(plan.joint_positions, plan.joint_rates, plan.dt)
        least, _ = least_clearance(task, places)
        lack = task.clearance + _SPARE * task.length - least
        clearance += max(lack, 0.0)
    return replace(aim, goal=goal, rotation=rotation, clearance=clearance)
