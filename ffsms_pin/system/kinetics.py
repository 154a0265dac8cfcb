"""Pinocchio's results at one configuration, and their change to the paper's convention.

Pinocchio's base velocity is that of the root frame's origin, in the root's own axes. The paper's is that of
the base's centre of mass, in inertial axes. With R the base attitude and c the centre of mass in the root
frame, v_root = A x_b where A = [[R^T, [c]x R^T], [0, R^T]]; everything else follows from that one matrix.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from scipy.linalg import lapack

from ffsms_pin.checks import FloatArray

__all__ = ["Kinetics", "cross_matrix", "evaluate", "to_paper", "to_root"]


class Kinetics(NamedTuple):
    """What one pass of Pinocchio gives at q. All arrays are copies.

    Attributes
    ----------
    M : ndarray, shape (6 + n, 6 + n)
        Inertia matrix in Pinocchio's own velocity coordinates.
    coupling : ndarray, shape (6, n)
        -M_b^-1 M_bm: the root's velocity, in its own axes, a joint rate.
    rotation, origin : ndarray, shape (3, 3), (3,)
        Pose of the root frame.
    J_e : ndarray, shape (6, 6 + n)
        End-effector Jacobian, inertial axes, in Pinocchio's velocity coordinates.
    end_effector : pinocchio.SE3
    com : ndarray, shape (3,)
        System centre of mass.
    """

    M: FloatArray
    coupling: FloatArray
    rotation: FloatArray
    origin: FloatArray
    J_e: FloatArray
    end_effector: Any
    com: FloatArray


def evaluate(model: Any, data: Any, frame: int, q: FloatArray) -> Kinetics:
    """Inertia, coupling and end-effector kinematics at q.

    Pinocchio's CRBA in the world convention leaves poses, joint Jacobians and the centre of mass behind, so
    one pass serves all.
    """
    M = pin.crba(model, data, q, pin.Convention.WORLD).copy()
    # Positive definite, so Cholesky: better than an inverse where a bare arm makes M_b ill-conditioned.
    _, coupling, _ = lapack.dposv(M[:6, :6], -M[:6, 6:])
    root = data.oMi[1]
    pose = pin.updateFramePlacement(model, data, frame)
    J_e = pin.getFrameJacobian(model, data, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    return Kinetics(
        M, coupling, root.rotation.copy(), root.translation.copy(), J_e, pose.copy(), data.com[0].copy()
    )


def cross_matrix(a: FloatArray) -> FloatArray:
    """The paper's skew matrix [a]x, with [a]x b = a x b."""
    x, y, z = a
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def to_root(rotation: FloatArray, lever: FloatArray) -> FloatArray:
    """The matrix A (6, 6): paper's base twist to Pinocchio's root velocity."""
    A = np.zeros((6, 6))
    Rt = rotation.T
    A[:3, :3] = Rt
    A[3:, 3:] = Rt
    A[:3, 3:] = cross_matrix(lever) @ Rt
    return A


def to_paper(rotation: FloatArray, lever: FloatArray) -> FloatArray:
    """The inverse of `to_root` (6, 6): Pinocchio's root velocity to the paper's base twist."""
    A = np.zeros((6, 6))
    A[:3, :3] = rotation
    A[3:, 3:] = rotation
    A[:3, 3:] = -rotation @ cross_matrix(lever)
    return A
