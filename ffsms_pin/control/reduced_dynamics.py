"""The dynamics that the joint torques see while the base floats: H_q and C_q alone, for a control loop."""

from __future__ import annotations

import pinocchio as pin
from scipy.linalg import lapack

from ffsms_pin.checks import FloatArray
from ffsms_pin.system import SpaceManipulator

__all__ = ["reduced_dynamics"]


def reduced_dynamics(sms: SpaceManipulator, q: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """H_q and C_q of tau = H_q qdd + C_q (paper, "Sliding Mode Control Design").

    The same values as `State.H_q` and `State.C_q`, without a state being made: nothing is checked.

    Parameters
    ----------
    sms : SpaceManipulator
    q : ndarray, shape (nq,)
        Configuration, Pinocchio's.
    v : ndarray, shape (6 + n,)
        Velocity, Pinocchio's.

    Returns
    -------
    H_q : ndarray, shape (n, n)
        Reduced inertia matrix: the Schur complement of the base block.
    C_q : ndarray, shape (n,)
        Reduced Coriolis and centrifugal torque [N m].
    """
    model, data = sms.model, sms._data
    M = pin.crba(model, data, q)
    effects = pin.nonLinearEffects(model, data, q, v)
    M_bm = M[:6, 6:]
    # Neither result depends on the axes or the reference point of the base's velocity, so Pinocchio's serve.
    _, reaction, _ = lapack.dposv(M[:6, :6], M_bm)
    return M[6:, 6:] - M_bm.T @ reaction, effects[6:] - effects[:6] @ reaction
