"""The motion that momentum alone gives: H_b^-1 h, and what the end effector has of it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray

__all__ = ["Drift", "momentum_drift"]


class Drift(NamedTuple):
    """Velocities with the joints held still.

    Attributes
    ----------
    root : ndarray, shape (6,)
        Of the root, in its own axes [m/s; rad/s] (Pinocchio's convention).
    tip_velocity, tip_spin : ndarray, shape (3,)
        Of the end effector, inertial axes [m/s], [rad/s].
    """

    root: FloatArray
    tip_velocity: FloatArray
    tip_spin: FloatArray


def momentum_drift(M: FloatArray, q: FloatArray, position: FloatArray, momentum: FloatArray) -> Drift:
    """The drift at one configuration; the same as `State.drift`, from what a step has at hand.

    Parameters
    ----------
    M : ndarray, shape (6 + n, 6 + n)
        Inertia matrix in Pinocchio's velocity coordinates.
    q : ndarray, shape (nq,)
    position : ndarray, shape (3,)
        Of the end effector, inertial axes [m].
    momentum : ndarray, shape (6,)
        [linear; angular], inertial axes, about the system's centre of mass.
    """
    R = pin.Quaternion(q[3:7]).toRotationMatrix()
    # The centre of mass in the root's axes, from the blocks of a rigid body's inertia.
    com = np.array([M[1, 5], M[2, 3], M[0, 4]]) / M[0, 0]
    linear, angular = R.T @ momentum[:3], R.T @ momentum[3:]
    root = np.linalg.solve(M[:6, :6], np.concatenate([linear, angular + np.cross(com, linear)]))
    arm = R.T @ (position - q[:3])
    return Drift(root, R @ (root[:3] + np.cross(root[3:], arm)), R @ root[3:])
