"""The attitude of the base: its error, the acceleration that removes it, and the torque that this takes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray, positive, rotation
from ffsms_pin.system import SpaceManipulator, dynamics

__all__ = ["AttitudeHold", "base_torque", "base_wrench", "held_dynamics"]


@dataclass
class AttitudeHold:
    """An attitude to hold, and the angular acceleration that turns the base to it.

    With eps and eta the vector and scalar part of the quaternion from the wanted attitude to the true one,
    and w the base's angular velocity,

        w' = -2 bandwidth^2 sign(eta) eps - 2 damping bandwidth w.

    Proof: V = w.w / 2 + 4 bandwidth^2 (1 - |eta|) has V' = -2 damping bandwidth w.w, since eta' = -eps.w / 2.
    Small errors die out as those of a mass on a spring with that bandwidth and damping.

    Source: B. Wie, H. Weiss, A. Arapostathis, "Quaternion feedback regulator for spacecraft eigenaxis
    rotations", Journal of Guidance, Control, and Dynamics 12 (1989).

    Parameters
    ----------
    bandwidth : float
        [rad/s]
    damping : float
        1 is critical.
    attitude : array_like, shape (3, 3), optional
        Rotation matrix of the root frame to hold, inertial axes. Default: that at the first control step.
    """

    bandwidth: float
    damping: float
    attitude: Any = None

    def __post_init__(self) -> None:
        self.bandwidth = positive("bandwidth", self.bandwidth, "rad/s")
        self.damping = positive("damping", self.damping)
        if self.attitude is not None:
            self.attitude = rotation("attitude", self.attitude)
        self._held: FloatArray | None = self.attitude

    def reset(self) -> None:
        """Forget the attitude of the last run."""
        self._held = self.attitude

    def acceleration(self, q: FloatArray, v: FloatArray) -> FloatArray:
        """The wanted angular acceleration of the base (3,) [rad/s^2], root axes."""
        turn = pin.Quaternion(q[3:7]).toRotationMatrix()
        if self._held is None:
            self._held = turn
        error = pin.Quaternion(self._held.T @ turn)
        side = 1.0 if error.w >= 0.0 else -1.0
        stiffness, drag = 2.0 * self.bandwidth**2, 2.0 * self.damping * self.bandwidth
        result: FloatArray = -stiffness * side * error.vec() - drag * v[3:6]
        return result


def held_dynamics(
    sms: SpaceManipulator, q: FloatArray, v: FloatArray, turn: FloatArray, qdd: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """What it takes to turn the base as wanted while the joints move as wanted, its place being free.

    Of M v' + c = [0; T; tau], with v' = [a; turn; qdd], the first three rows give a: no force acts. The base
    turns by `turn` (3,) [rad/s^2], root axes. Gives T (3,) on the base and tau (n,) [N m].
    """
    M, effects = dynamics.inertia_matrix(sms, q), dynamics.velocity_effects(sms, q, v)
    acceleration = np.concatenate([np.zeros(3), turn, qdd])
    acceleration[:3] = -(M[:3] @ acceleration + effects[:3]) / M[0, 0]
    force = M @ acceleration + effects
    return force[3:6], force[6:]


def base_wrench(
    sms: SpaceManipulator,
    q: FloatArray,
    v: FloatArray,
    tau: FloatArray,
    known: FloatArray,
    free: FloatArray,
) -> FloatArray:
    """Force [N] and moment [N m] on the root (6,), root axes, for an acceleration of the base known in part.

    Of M v' + c = [wrench; tau] with v' = [known + free x; qdd], the joints' accelerations qdd and x are what
    they become: along `free` no wrench acts, free^T wrench = 0.

    Parameters
    ----------
    sms : SpaceManipulator
    q, v : ndarray, shape (nq,), (6 + n,)
    tau : ndarray, shape (n,)
        Joint torques [N m].
    known : ndarray, shape (6,)
        Of the base's acceleration, Pinocchio's v'[:6] [m/s^2; rad/s^2].
    free : ndarray, shape (6, k)
        Directions in which the base gives way.
    """
    M, effects = dynamics.inertia_matrix(sms, q), dynamics.velocity_effects(sms, q, v)
    k, n = free.shape[1], sms.n
    ways = np.zeros((6 + n, k + n))
    ways[:6, :k], ways[6:, k:] = free, np.eye(n)
    moved = np.concatenate([known, np.zeros(n)])
    acting = np.concatenate([np.zeros(6), tau]) - M @ moved - effects
    rest = np.linalg.solve(ways.T @ M @ ways, ways.T @ acting)
    wrench: FloatArray = (M @ (moved + ways @ rest) + effects)[:6]
    return wrench


def base_torque(
    sms: SpaceManipulator, q: FloatArray, v: FloatArray, turn: FloatArray, tau: FloatArray
) -> FloatArray:
    """Torque on the base (3,) [N m] that turns it as wanted while joint torques `tau` (n,) act.

    The joints' accelerations and the base's linear one are what they become; other arguments as for
    `held_dynamics`.
    """
    known = np.concatenate([np.zeros(3), turn])
    return base_wrench(sms, q, v, tau, known, np.eye(6)[:, :3])[3:]
