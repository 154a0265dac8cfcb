"""What one planning step needs of the dynamics, and no more: J*, V and the entropy."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.linalg import lapack

from ffsms_pin.checks import FloatArray
from ffsms_pin.coupling import decompose, normalised_entropy
from ffsms_pin.system import SpaceManipulator

__all__ = ["StepKinetics", "step_kinetics"]


class StepKinetics(NamedTuple):
    """What a step needs, at one configuration.

    Attributes
    ----------
    M : ndarray, shape (6 + n, 6 + n)
        Inertia matrix in Pinocchio's velocity coordinates.
    coupling : ndarray, shape (6, n)
        Root velocity, in the root's own axes, a joint rate (Pinocchio's convention).
    J_v, J_w : ndarray, shape (3, n)
        Linear and angular rows of J*.
    V : ndarray, shape (n, n)
        Right singular vectors of C_bm.
    entropy : float
    position : ndarray, shape (3,)
        Of the end effector [m].
    rotation : ndarray, shape (3, 3)
        Of the end effector.
    """

    M: FloatArray
    coupling: FloatArray
    J_v: FloatArray
    J_w: FloatArray
    V: FloatArray
    entropy: float
    position: FloatArray
    rotation: FloatArray


def step_kinetics(sms: SpaceManipulator, q: FloatArray) -> StepKinetics:
    """The same values as `State` gives, in one pass; leaves poses and Jacobians in the workspace."""
    model, data = sms.model, sms._data
    M = pin.crba(model, data, q, pin.Convention.WORLD)
    _, coupling, _ = lapack.dposv(M[:6, :6], -M[:6, 6:])
    pose = pin.updateFramePlacement(model, data, sms.frame_id)
    J = pin.getFrameJacobian(model, data, sms.frame_id, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    J_star = J[:, :6] @ coupling + J[:, 6:]
    C_bm = coupling
    if sms.base_com.any():
        # The singular values depend on the reference point, not on the axes: shift to the base's centre of
        # mass in the root's axes, and leave the rotation out.
        C_bm = coupling.copy()
        C_bm[:3] -= np.cross(sms.base_com, coupling[3:], axisb=0, axisc=0)
    _, sigma, V = decompose(C_bm)
    entropy = normalised_entropy(sigma, sms.n)
    position, rotation = pose.translation.copy(), pose.rotation.copy()
    return StepKinetics(M, coupling, J_star[:3], J_star[3:], V, entropy, position, rotation)
