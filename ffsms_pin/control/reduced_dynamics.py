"""The dynamics that joint torques see while the base floats: H_q, C_q and its matrix, for a control loop."""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray, instance, sized
from ffsms_pin.system import SpaceManipulator, dynamics
from ffsms_pin.system.base_reaction import floating_motion


def reduced_dynamics(sms: SpaceManipulator, q: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """H_q and C_q of tau = H_q qdd + C_q (paper, "Sliding Mode Control Design").

    The same values as `State.H_q` and `State.C_q`, without a state being made: of the arguments only
    kind and shape are checked.

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
    H_q, C_q, _ = _with_motion(sms, q, v)
    return H_q, C_q


def reduced_coriolis(
    sms: SpaceManipulator, q: FloatArray, v: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """H_q, C_q and the Coriolis matrix of the reduced system: see `State.C_q_matrix`.

    Parameters and the first two results as for `reduced_dynamics`.

    Returns
    -------
    H_q : ndarray, shape (n, n)
    C_q : ndarray, shape (n,)
        At the velocity as it is, momentum included.
    C : ndarray, shape (n, n)
        At the joint rates and zero momentum: dH_q/dt - 2 C is skew, and C qd = C_q where there is none.
    """
    H_q, C_q, N = _with_motion(sms, q, v)
    with np.errstate(over="ignore", invalid="ignore"):  # what is no number gives none
        return H_q, C_q, dynamics.reduced_coriolis_matrix(sms, q, N, v[6:])


def _with_motion(sms: SpaceManipulator, q: FloatArray, v: FloatArray) -> tuple[FloatArray, ...]:
    """H_q, C_q, and the motion N (6 + n, n) of all over the joint rates at zero momentum."""
    instance("sms", sms, SpaceManipulator)
    q, v = sized("q", q, sms.nq), sized("v", v, sms.nv)
    M = dynamics.inertia_matrix(sms, q)
    N = floating_motion(M)
    return M[6:] @ N, dynamics.velocity_effects(sms, q, v) @ N, N
