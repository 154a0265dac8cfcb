"""What a step has to know of the robot: one inertia matrix, one Jacobian and one decomposition."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin import lapack
from ffsms_pin.checks import FloatArray, frozen
from ffsms_pin.coupling import decompose
from ffsms_pin.coupling.metrics import entropy_of_values
from ffsms_pin.opt.limits.step_state import StepState
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.base_reaction import mode_reaction

__all__ = ["step_state"]

_STILL = frozen(np.zeros(6))
_WORLD, _AXES = pin.Convention.WORLD, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


def step_state(
    sms: SpaceManipulator,
    q: FloatArray,
    rates: FloatArray,
    dt: float,
    time_left: float,
    momentum: FloatArray | None = None,
    base_start: FloatArray | None = None,
    data: Any = None,
    time: float = 0.0,
    mode: str = "floating",
    wheel_total: FloatArray | None = None,
) -> StepState:
    """The robot at the start of a step.

    Parameters
    ----------
    sms : SpaceManipulator
    q, rates : ndarray, shape (nq,), (n,)
        Configuration, and joint rates [rad/s].
    dt, time_left : float
        Step, and time to the deadline [s].
    momentum : ndarray, shape (6,), optional
        Total momentum [linear; angular], inertial axes, about the system's centre of mass. Default zero.
    base_start : ndarray, shape (7,), optional
        Root pose that turn and shift of the base count from; default: where it is now.
    data : pinocchio.Data, optional
        Scratch memory of `sms.model`, of one thread only; default: new.
    time : float
        Of the step's start, from the start of the motion [s].
    mode : str
        What of the base is held, one of `ffsms_pin.system.base_reaction.MODES`.
    wheel_total : ndarray, shape (w,), optional
        See `StepState`.
    """
    model, n = sms.model, sms.n
    data = model.createData() if data is None else data
    # In the world's convention this also leaves the Jacobians of the joints and all poses in `data`.
    M = pin.crba(model, data, q, _WORLD)
    pose = pin.updateFramePlacement(model, data, sms.frame_id)
    J = pin.getFrameJacobian(model, data, sms.frame_id, _AXES)
    M_b, J_b, J_arm = M[:6, :6], J[:, :6], J[:, 6:]
    if mode != "floating":
        reaction, drift = mode_reaction(M, sms.base_com, mode), _STILL
        if momentum is not None:  # linear only: see `Problem`
            drift = np.zeros(6)
            drift[:3] = pin.Quaternion(q[3:7]).toRotationMatrix().T @ momentum[:3] / M[0, 0]
        tip_drift = J_b.dot(drift)
    elif momentum is None:
        reaction, drift = -lapack.dposv(M_b, M[:6, 6:])[1], _STILL
        tip_drift = _STILL
    else:
        right = np.column_stack([-M[:6, 6:], root_momentum(M, q, momentum)])
        solution = lapack.dposv(M_b, right)[1]
        reaction, drift = solution[:, :n], solution[:, n]
        tip_drift = J_b.dot(drift)
    # Singular values depend on the reference point, not on the axes: the base's centre of mass, root's axes.
    _, sigma, V = decompose(sms.root_to_com.dot(reaction))
    return StepState(
        sms=sms,
        dt=dt,
        time_left=time_left,
        q=q,
        joints=sms.layout.positions(q),
        rates=rates,
        M=M,
        reaction=reaction,
        J_star=J_b.dot(reaction) + J_arm,
        J_arm=J_arm,
        V=V,
        entropy=entropy_of_values(sigma.tolist(), n),
        pose=pose.copy(),
        drift=drift,
        tip_drift=tip_drift,
        momentum=momentum,
        base_start=q[:7].copy() if base_start is None else base_start,
        time=time,
        mode=mode,
        wheel_total=wheel_total,
    )


def root_momentum(M: FloatArray, q: FloatArray, momentum: FloatArray) -> FloatArray:
    """The total momentum (6,) about the root's origin, in the root's axes.

    Parameters
    ----------
    M : ndarray, shape (6 + n, 6 + n)
        Inertia matrix in Pinocchio's velocity coordinates.
    q : ndarray, shape (nq,)
    momentum : ndarray, shape (6,)
        [linear; angular], inertial axes, about the system's centre of mass.
    """
    R = pin.Quaternion(q[3:7]).toRotationMatrix()
    # The centre of mass in the root's axes, from the blocks of a rigid body's inertia.
    com = np.array([M[1, 5], M[2, 3], M[0, 4]]) / M[0, 0]
    linear, angular = R.T @ momentum[:3], R.T @ momentum[3:]
    return np.concatenate([linear, angular + np.cross(com, linear)])
