"""Bias accelerations: how base and end effector accelerate while the joints keep their rates.

Nothing acts on the base, so with zero joint accelerations the base rows of the equations of motion give the
root's acceleration, and one kinematics pass gives the rest. With zero momentum these accelerations are
dC_bm/dt qd and dJ*/dt qd.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin import lapack
from ffsms_pin.checks import FloatArray
from ffsms_pin.system.kinetics import cross_matrix

__all__ = ["bias_accelerations"]


def bias_accelerations(
    model: Any, data: Any, frame: int, base_com: FloatArray, M: FloatArray, q: FloatArray, v: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Accelerations of the base and of the end effector, joint accelerations zero, the base reacting.

    Parameters
    ----------
    model, data : pinocchio.Model, pinocchio.Data
    frame : int
        The end effector's frame.
    base_com : ndarray, shape (3,)
        Centre of mass of the base body in the root frame [m].
    M : ndarray, shape (6 + n, 6 + n)
        Pinocchio's inertia matrix at q.
    q, v : ndarray, shape (nq,), (6 + n,)
        Of any momentum.

    Returns
    -------
    base, end_effector : ndarray, shape (6,)
        Rates of the twists [m/s^2; rad/s^2], inertial axes: of the base's centre of mass and of the end
        effector's origin. The linear part is the acceleration of the point (the classical one, not the
        spatial one).
    """
    effects = pin.nonLinearEffects(model, data, q, v)
    acceleration = np.zeros(model.nv)
    _, acceleration[:6], _ = lapack.dposv(M[:6, :6], -effects[:6])
    pin.forwardKinematics(model, data, q, v, acceleration)
    axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    end_effector = pin.getFrameClassicalAcceleration(model, data, frame, axes).vector.copy()
    base = pin.getClassicalAcceleration(model, data, 1, axes).vector.copy()
    rotation = data.oMi[1].rotation
    lever, omega = rotation @ base_com, rotation @ v[3:6]
    turning = cross_matrix(omega)
    base[:3] += cross_matrix(base[3:]) @ lever + turning @ (turning @ lever)
    return base, end_effector
