"""Poses, twists and Jacobians of the base and the end effector, as functions that return what they find.

Inertial axes; twists ordered [linear; angular]. The base's reference point is the centre of mass of the base
body, the end effector's the origin of its frame.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin import lapack
from ffsms_pin.checks import FloatArray
from ffsms_pin.system.mechanism import Mechanism, scratch

__all__ = [
    "at_origin",
    "base_pose",
    "end_to_base",
    "frame_jacobian",
    "frame_pose",
    "generalised_jacobian",
]

_AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
# A singular value of J* below this fraction of the largest counts as zero.
RANK_TOLERANCE = 1e-10
_WORK = 64  # numbers of scratch space for dgelsy, which needs 25 for six columns


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


def generalised_jacobian(J: FloatArray, N: FloatArray) -> FloatArray:
    """J* (6, n): end-effector twist a joint rate at zero momentum (Umetani and Yoshida 1989).

    Parameters
    ----------
    J : ndarray, shape (6, 6 + n)
        `frame_jacobian`.
    N : ndarray, shape (6 + n, n)
        `base_reaction.floating_motion`.

    Notes
    -----
    The same as J_b C_bm + J_m of the paper (Eq. DC_GJM), in other coordinates of the base's velocity.
    """
    J_star: FloatArray = J.dot(N)
    return J_star


def end_to_base(C_bm: FloatArray, J_star: FloatArray) -> FloatArray:
    """End-to-base coupling C_be (6, 6): C_bm J*^+ (paper Eq. DC_4), J*^+ the pseudo-inverse.

    Rounding leaves about 1e-16 of what is exactly zero at a singular posture, or out of an arm's plane, so
    singular values of J* below 1e-10 of the largest count as zero.
    """
    # The least X with J*^T X = C_bm^T, by a complete orthogonal factorisation. LAPACK writes the six rows of
    # X over the n rows of C_bm^T, so it wants room for the larger of the two.
    n = C_bm.shape[1]
    right = np.zeros((max(6, n), 6))
    right[:n] = C_bm.T
    any_column_first = np.zeros(6, np.int32)
    _, X, *_ = lapack.dgelsy(J_star.T, right, any_column_first, RANK_TOLERANCE, _WORK)
    C_be: FloatArray = X[:6].T
    return C_be
