"""A last resort within the base's limits: the march of single steps, whose rows keep them."""

from __future__ import annotations

import numpy as np

from ffsms_pin.opt.horizon.motion import trajectory
from ffsms_pin.opt.horizon.task import Task
from ffsms_pin.opt.marching import march
from ffsms_pin.opt.step_planner import StepPlanner
from ffsms_pin.opt.trajectory import Trajectory

__all__ = ["careful_march"]


def careful_march(task: Task) -> Trajectory:
    """A plan that goes as far towards the target as the base's limits allow it step by step."""
    mode = "off" if task.clearances is None else task.clearances.mode
    limits, momentum = task.base_limits, task.momentum
    planner = StepPlanner(
        task.sms, task.dt, task.kappa, task.clearance, mode, base_limits=limits, momentum=momentum
    )
    plan = march(planner, task.q0, task.target, task.duration, rotation=task.rotation)
    return trajectory(task, np.array(plan.joint_rates))
