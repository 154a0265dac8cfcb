"""The dynamics that joint torques see while the base floats: H_q, C_q and its matrix, for a control loop."""

from __future__ import annotations

import pinocchio as pin
from scipy.linalg import lapack

from ffsms_pin.checks import FloatArray, instance, sized
from ffsms_pin.system import SpaceManipulator

__all__ = ["floating_torque", "reduced_coriolis", "reduced_dynamics", "reduced_torque"]


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
    instance("sms", sms, SpaceManipulator)
    q, v = sized("q", q, sms.nq), sized("v", v, sms.nv)
    model, data = sms.model, sms._data
    M = pin.crba(model, data, q)
    effects = pin.nonLinearEffects(model, data, q, v)
    M_bm = M[:6, 6:]
    # Neither result depends on the axes or the reference point of the base's velocity, so Pinocchio's serve.
    _, reaction, _ = lapack.dposv(M[:6, :6], M_bm)
    return M[6:, 6:] - M_bm.T @ reaction, effects[6:] - effects[:6] @ reaction


def reduced_torque(sms: SpaceManipulator, q: FloatArray, v: FloatArray, qdd: FloatArray) -> FloatArray:
    """Torques H_q qdd + C_q (n,) [N m]: they give the joints the accelerations qdd (n,), the base reacting.

    Without the two being made: see `floating_torque`. Other arguments as for `reduced_dynamics`.
    """
    return floating_torque(sms, q, v, sms._joints_alone.dot(qdd))


def floating_torque(
    sms: SpaceManipulator, q: FloatArray, v: FloatArray, acceleration: FloatArray
) -> FloatArray:
    """The same of `acceleration` (6 + n,): six zeros, then the joint accelerations.

    With f the generalised force that holds the base's acceleration at zero, the base takes up f_b by
    accelerating, so tau = f_m - M_bm^T M_b^-1 f_b.
    """
    model, work = sms.model, sms._workspace
    data = work.data
    force = pin.rnea(model, data, q, v, acceleration)
    pin.crba(model, data, q)
    # M_b is the whole's inertia in the root frame. All columns of the product: numpy copies slices of them.
    force -= work.whole.inverse().dot(force[:6]).dot(work.base_rows)
    tau: FloatArray = force[6:]
    return tau


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
    instance("sms", sms, SpaceManipulator)
    q, v = sized("q", q, sms.nq), sized("v", v, sms.nv)
    model, data = sms.model, sms._data
    M = pin.crba(model, data, q).copy()
    effects = pin.nonLinearEffects(model, data, q, v)
    _, reaction, _ = lapack.dposv(M[:6, :6], M[:6, 6:])
    H_q = M[6:, 6:] - M[6:, :6] @ reaction
    C_q = effects[6:] - effects[:6] @ reaction
    still = v.copy()
    still[:6] = -(reaction @ v[6:])
    C = pin.computeCoriolisMatrix(model, data, q, still)
    # N^T C N with N = [-reaction; I].
    upper = C[:6, 6:] - C[:6, :6] @ reaction
    return H_q, C_q, C[6:, 6:] - C[6:, :6] @ reaction - reaction.T @ upper
