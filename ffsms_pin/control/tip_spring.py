"""A spring between the end effectors of two joint motions, both with a reacting base.

Except for the drift by momentum, the joint motion alone determines the motion of a floating base and its end
effector. So both motions are rolled out from one base, in a frame C that drifts with the system. The origin
of C is the centre of mass, and C rotates with the part of the base's rotation that the joints do not cause.
Relative to C the first end effector moves with J_star qd, for any external forces and any true masses,
because J_star and C belong to the same model. So the joint torques J_star^T f of a force f = -dU/dx are the
negative gradient of U with respect to the joints, and the spring is passive.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, limit, one_each, positive
from ffsms_pin.coupling import NULL_SPACE_TOLERANCE
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system import dynamics
from ffsms_pin.system.dynamics import floating_motion, whole_body


class Posture(NamedTuple):
    """A posture of a robot with its root at the origin; all quantities are in root axes.

    The fields are the configuration `q` (nq,), the inertia matrix `M`, `N` of `floating_motion`, the system's
    centre of mass `com` (3,) and the end effector's `pose` (pinocchio.SE3).
    """

    q: FloatArray
    M: FloatArray
    N: FloatArray
    com: FloatArray
    pose: Any

    @property
    def H_q(self) -> FloatArray:
        """The reduced inertia matrix (n, n)."""
        H_q: FloatArray = self.M[6:] @ self.N
        return H_q


def posture(sms: SpaceManipulator, q: FloatArray) -> Posture:
    """Return the posture of q (nq,), without its base pose."""
    q = q.copy()
    q[:7] = 0.0
    q[6] = 1.0
    M = dynamics.inertia_matrix(sms, q)
    return Posture(q, M, floating_motion(M), whole_body(M).lever.copy(), dynamics.frame_pose(sms, q))


class MotionPair(NamedTuple):
    """A pair of joint motions at one time.

    `turn` (3, 3) is the attitude of the second base in the axes of the first base. `nullspace` (n,) is the
    displacement of the first joints from the second joints. After each step, a law keeps only the part of the
    displacement in the end effector's nullspace (`Pull.nullspace`).
    """

    first: Posture
    second: Posture
    turn: FloatArray
    nullspace: FloatArray


def advance(sms: SpaceManipulator, q: FloatArray, q_d: FloatArray, before: MotionPair | None) -> MotionPair:
    """Return both motions one step after `before`, at q (nq,) and joints q_d (n,).

    If `before` is None, the second base results from the straight joint motion from q to q_d.
    """
    at_d = q.copy()
    sms.layout.set_positions(at_d, q_d)
    first, second = posture(sms, q), posture(sms, at_d)
    if before is None:
        displacement, turn = _displacement(sms, second, first)
        return MotionPair(first, second, turn.T, displacement)
    displacement, turn = _displacement(sms, before.first, first)
    displacement_d, turn_d = _displacement(sms, before.second, second)
    return MotionPair(
        first, second, turn.T @ before.turn @ turn_d, before.nullspace + displacement - displacement_d
    )


def _displacement(sms: SpaceManipulator, start: Posture, end: Posture) -> tuple[FloatArray, FloatArray]:
    """Return the joint displacement (n,) between two postures, and the base's rotation due to it (3, 3)."""
    displacement = sms.layout.difference(end.q, sms.layout.positions(start.q))
    return displacement, pin.exp3(0.5 * (start.N[3:6] + end.N[3:6]) @ displacement)


class Pull(NamedTuple):
    """The result of a `TipSpring`: `torque` (n,) [N m], joint `stiffness` (n, n) and `energy` [J].

    The force limit does not reduce the stiffness. `J_star` (6, n) and the attitude `axes` (3, 3) are those of
    the first end effector, in its root's axes. `nullspace` (n,) is the displacement of `MotionPair`,
    projected on the end effector's nullspace.
    """

    torque: FloatArray
    stiffness: FloatArray
    energy: float
    J_star: FloatArray
    axes: FloatArray
    nullspace: FloatArray


class TipSpring:
    """A spring from one end effector to another, and a weak joint spring in the nullspace.

    Let e be the displacement from the desired position and phi the rotation vector from the desired attitude,
    both in the desired end effector's axes. The energy is

        U = u(e^T K e) + phi^T K_r phi / 2 + k |q_n|^2 / 2,

    where q_n is the joint displacement in the nullspace, and K, K_r and k are the stiffnesses of translation,
    rotation and posture. u(s^2) is s^2 / 2 up to the s at which the force -dU/de of the stiffest axis reaches
    the force limit. Beyond, u is linear in s, so the force is within the limit in every direction. The moment
    is -J_r^-T K_r phi in the first end effector's axes, with the right Jacobian J_r of SO(3). The moment is
    the exact gradient, also for three different stiffnesses.
    """

    def __init__(
        self, stiffness: ArrayLike, turn_stiffness: ArrayLike, posture_stiffness: float, force_limit: float
    ) -> None:
        self.stiffness = one_each("stiffness", stiffness, 3, "N/m")
        self.turn_stiffness = one_each("turn_stiffness", turn_stiffness, 3, "N m/rad")
        self.posture_stiffness = positive("posture_stiffness", posture_stiffness, "N m/rad")
        self.force_limit = limit("force_limit", force_limit, "N")
        self._most = self.force_limit / float(np.sqrt(self.stiffness.max()))

    def pull(self, sms: SpaceManipulator, now: MotionPair, desired: Any = None) -> Pull:
        """Return the effect of the spring on the joints of `now.first`.

        `desired` (pinocchio.SE3), in the frame of the first root, replaces the end effector's pose of
        `now.second`.
        """
        first, second = now.first, now.second
        if desired is None:
            place = first.com + now.turn @ (second.pose.translation - second.com)
            desired = pin.SE3(now.turn @ second.pose.rotation, place)
        off = desired.inverse() * first.pose
        e, phi = off.translation, pin.log3(off.rotation)
        pushed = self.stiffness * e
        s = float(np.sqrt(e @ pushed))
        share = min(1.0, self._most / s) if s > 0.0 else 1.0
        J = dynamics.frame_jacobian(sms, first.q) @ first.N
        axes = first.pose.rotation
        moment = pin.Jlog3(off.rotation).T @ (self.turn_stiffness * phi)
        torque = -(share * (desired.rotation @ pushed) @ J[:3]) - (axes @ moment) @ J[3:]
        K = J[:3].T @ ((desired.rotation * self.stiffness) @ desired.rotation.T) @ J[:3]
        K += J[3:].T @ ((axes * self.turn_stiffness) @ axes.T) @ J[3:]
        free = _free(J)
        nullspace = free @ now.nullspace
        k = self.posture_stiffness
        energy = s * s / 2.0 if share == 1.0 else self._most * (s - self._most / 2.0)
        energy += float(phi @ (self.turn_stiffness * phi) + k * (nullspace @ nullspace)) / 2.0
        return Pull(torque - k * nullspace, K + k * free, energy, J, axes, nullspace)


def _free(J: FloatArray) -> FloatArray:
    """Return the projector (n, n) onto the joint rates in the nullspace of the end effector."""
    _, sigma, Vt = np.linalg.svd(J)
    rank = int(np.count_nonzero(sigma > NULL_SPACE_TOLERANCE * sigma[0]))
    free: FloatArray = Vt[rank:].T @ Vt[rank:]
    return free


def modal_damping(H: FloatArray, K: FloatArray, ratio: float) -> FloatArray:
    """Return D (n, n) >= 0 that gives all modes of H x'' + D x' + K x = 0 the damping ratio `ratio`.

    Source: A. Albu-Schaeffer, C. Ott, U. Frese, G. Hirzinger, "Cartesian impedance control of redundant
    robots: recent results with the DLR-light-weight-arms", ICRA (2003).
    """
    from scipy.linalg import eigh  # slow to load

    squares, modes = eigh(K, H, check_finite=False)
    spread = H @ modes
    D: FloatArray = (spread * (2.0 * ratio * np.sqrt(np.maximum(squares, 0.0)))) @ spread.T
    return D
