"""What one planning step needs of the dynamics, and no more: J*, V and the entropy."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin import lapack
from ffsms_pin.checks import FloatArray
from ffsms_pin.coupling import decompose
from ffsms_pin.coupling.metrics import entropy_of_values
from ffsms_pin.system import SpaceManipulator

__all__ = ["KineticsAt", "StepKinetics", "step_kinetics"]

_WORLD, _AXES = pin.Convention.WORLD, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


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
    pose : pinocchio.SE3
        Of the end effector, inertial axes.
    data : pinocchio.Data
        With the poses and joint Jacobians.
    """

    M: FloatArray
    coupling: FloatArray
    J_v: FloatArray
    J_w: FloatArray
    V: FloatArray
    entropy: float
    pose: Any
    data: Any

    @property
    def position(self) -> FloatArray:
        """Position (3,) of the end effector [m]."""
        position: FloatArray = self.pose.translation.copy()
        return position

    @property
    def rotation(self) -> FloatArray:
        """Rotation (3, 3) of the end effector."""
        rotation: FloatArray = self.pose.rotation.copy()
        return rotation


class KineticsAt:
    """The same values as `State` gives, in one pass; for one thread, since it reuses its arrays.

    Parameters
    ----------
    sms : SpaceManipulator
    """

    def __init__(self, sms: SpaceManipulator) -> None:
        self._sms, self._data = sms, sms.model.createData()
        # Velocities of root and joints a joint rate: the coupling above the identity.
        self._motion = np.vstack([np.zeros((6, sms.n)), np.eye(sms.n)])
        self._coupling = self._motion[:6]
        # The singular values depend on the reference point, not on the axes: shift to the base's centre of
        # mass in the root's axes, and leave the rotation out.
        self._to_com = np.eye(6)
        x, y, z = sms.base_com.tolist()
        self._to_com[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]  # omega x com
        self._shifted = bool(sms.base_com.any())

    def __reduce__(self) -> tuple[Any, ...]:
        return KineticsAt, (self._sms,)

    def __call__(self, q: FloatArray) -> StepKinetics:
        """Kinetics at q (nq,), valid until the next call."""
        sms, coupling = self._sms, self._coupling
        model, data, frame = sms.model, self._data, sms.frame_id
        M = pin.crba(model, data, q, _WORLD)
        np.negative(lapack.dposv(M[:6, :6], M[:6, 6:])[1], coupling)
        pose = pin.updateFramePlacement(model, data, frame)
        J_star = pin.getFrameJacobian(model, data, frame, _AXES).dot(self._motion)
        _, sigma, V = decompose(self._to_com.dot(coupling) if self._shifted else coupling)
        entropy = entropy_of_values(sigma.tolist(), sms.n)
        return StepKinetics(M, coupling, J_star[:3], J_star[3:], V, entropy, pose, data)


def step_kinetics(sms: SpaceManipulator, q: FloatArray) -> StepKinetics:
    """What a step needs at q (nq,)."""
    return KineticsAt(sms)(q)
