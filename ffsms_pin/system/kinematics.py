"""Poses, twists and Jacobians of the base and the end effector, as functions that return what they find.

Inertial axes; twists ordered [linear; angular]. The base's reference point is the centre of mass of the base
body, the end effector's the origin of its frame.
"""

from __future__ import annotations

from typing import Any

import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.system.mechanism import Mechanism, scratch

__all__ = [
    "at_origin",
    "base_pose",
    "frame_jacobian",
    "frame_pose",
]

_AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


def at_origin(q: FloatArray) -> FloatArray:
    """Copy of q (nq,) with the root at the inertial origin.

    For all that does not depend on where the root is: sums about the origin lose digits with the square of
    the distance.
    """
    moved = q.copy()
    moved[:3] = 0.0
    return moved


def base_pose(robot: Mechanism, q: FloatArray) -> Any:
    """Pose of the base (pinocchio.SE3): the root's axes, at the base's centre of mass."""
    pose = pin.XYZQUATToSE3(q[:7])
    pose.translation = pose.act(robot.base_com)
    return pose


def frame_pose(robot: Mechanism, q: FloatArray) -> Any:
    """Pose of the end-effector frame (pinocchio.SE3) at q (nq,)."""
    data = scratch(robot)
    pin.forwardKinematics(robot.model, data, q)
    return pin.updateFramePlacement(robot.model, data, robot.frame_id).copy()


def frame_jacobian(robot: Mechanism, q: FloatArray) -> FloatArray:
    """Jacobian (6, 6 + n) of the end-effector twist, in Pinocchio's velocity coordinates."""
    J: FloatArray = pin.computeFrameJacobian(robot.model, scratch(robot), at_origin(q), robot.frame_id, _AXES)
    return J
