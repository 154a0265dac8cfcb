"""The export of plans as ROS 2 messages in text form; ROS need not be installed."""

from __future__ import annotations

import json

import numpy as np

from ffsms_pin.checks import whole
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt import Trajectory
from ffsms_pin.robot import SpaceManipulator


def to_joint_trajectory(sms: SpaceManipulator, plan: Trajectory, every: int = 1, frame: str = "") -> str:
    """Return a plan as YAML text of ROS 2's `trajectory_msgs/JointTrajectory`, for `ros2 topic pub`.

    The points have positions [rad or m], velocities and accelerations of the joints. The base's motion is
    left out, because a joint controller cannot command it.

    Parameters
    ----------
    sms : SpaceManipulator
    plan : Trajectory
    every : int
        The message has every `every`-th node of the plan, and the last node.
    frame : str
        The message's `header.frame_id`.

    Raises
    ------
    InvalidValue
        `every` is not a whole number of at least one, or the plan has another number of joints.
    """
    whole("every", every, 1)
    if (n := plan.joint_accelerations.shape[1]) != sms.n:
        raise InvalidValue("plan", plan, f"has {n} joints, but the robot has {sms.n}")
    nodes = sorted({*range(0, len(plan.t), every), len(plan.t) - 1})
    acceleration = np.vstack([plan.joint_accelerations, np.zeros((1, sms.n))])
    lines = [
        "header:",
        "  stamp: {sec: 0, nanosec: 0}",
        f"  frame_id: {json.dumps(frame)}",
        f"joint_names: {json.dumps(list(sms.joint_names))}",
        "points:",
    ]
    for k in nodes:
        seconds, nanoseconds = divmod(round(plan.t[k] * 1e9), 1_000_000_000)
        lines += [
            f"- positions: {json.dumps(plan.joint_positions[k].tolist())}",
            f"  velocities: {json.dumps(plan.v[k, 6:].tolist())}",
            f"  accelerations: {json.dumps(acceleration[k].tolist())}",
            "  effort: []",
            f"  time_from_start: {{sec: {seconds}, nanosec: {nanoseconds}}}",
        ]
    return "\n".join(lines) + "\n"
