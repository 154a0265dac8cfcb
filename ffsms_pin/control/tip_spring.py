"""A spring between the end effectors of two joint motions, each rolled out with the base reacting.

Except for the drift by momentum, joint motions alone determine the motion of a floating base and its end
effector. So both motions are rolled out from one base, in a frame C that drifts with the system: its origin
is the centre of mass, and it has the part of the base's rotation that the joints do not cause. Relative to C
the first end effector moves with J_star qd, for any external forces and any true masses, because J_star and C
belong to one model. Hence the joint torques J_star^T f of a force f = -dU/dx are the gradient of the same
potential U: a spring in this frame is passive.
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

    `q` (nq,), inertia matrix `M`, `N` of `floating_motion`, the system's centre of mass `com` (3,) and the
    end effector's `pose`.
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


class Apart(NamedTuple):
    """A pair of joint motions at one time; `turn` (3, 3) is the second base's attitude in the first's axes.

    `wound` (n,) is the displacement of the first joints from the second ones. In every step, its user
    projects out the part that moves the end effector.
    """

    first: Posture
    second: Posture
    turn: FloatArray
    wound: FloatArray


def apart(sms: SpaceManipulator, q: FloatArray, q_d: FloatArray, before: Apart | None) -> Apart:
    """Return both motions one step later, at q (nq,) and joints q_d (n,).

    Without `before`, the second base is reached from the first by the straight joint motion from q to q_d.
    """
    at_d = q.copy()
    sms.layout.set_positions(at_d, q_d)
    first, second = posture(sms, q), posture(sms, at_d)
    if before is None:
        displacement, turn = _way(sms, second, first)
        return Apart(first, second, turn.T, displacement)
    displacement, turn = _way(sms, before.first, first)
    way_d, turn_d = _way(sms, before.second, second)
    return Apart(first, second, turn.T @ before.turn @ turn_d, before.wound + displacement - way_d)


def _way(sms: SpaceManipulator, start: Posture, end: Posture) -> tuple[FloatArray, FloatArray]:
    """Return the joints' displacement between two postures (n,), and the base's rotation by it (3, 3)."""
    displacement = sms.layout.difference(end.q, sms.layout.positions(start.q))
    return displacement, pin.exp3(0.5 * (start.N[3:6] + end.N[3:6]) @ displacement)


class Pull(NamedTuple):
    """The result of a `TipSpring`: `torque` (n,), joint `stiffness` (n, n) and `energy` [J].

    `J_star` (6, n) and `axes` (3, 3), those of the first end effector, are in its root's axes; `wound` (n,)
    is the projected displacement of `Apart`.
    """

    torque: FloatArray
    stiffness: FloatArray
    energy: float
    J_star: FloatArray
    axes: FloatArray
    wound: FloatArray


class TipSpring:
    """A spring from one end effector to another, and a weak joint spring in its nullspace.

    With e the displacement from the desired position and phi the rotation vector from the desired attitude,
    both in the desired end effector's axes,

        U = u(e^T K e) + phi^T K_r phi / 2 + k |wound|^2 / 2.

    u(s^2) is s^2 / 2 up to the s at which the force -dU/de of the stiffest axis reaches the force limit, and
    linear in s beyond, so the force stays within the limit in every direction. The moment is -J_r^-T K_r phi
    in the first end effector's axes, J_r the right Jacobian of SO(3): the exact gradient, also for three
    different stiffnesses.
    """

    def __init__(
        self, stiffness: ArrayLike, turn_stiffness: ArrayLike, posture_stiffness: float, force_limit: float
    ) -> None:
        self.stiffness = one_each("stiffness", stiffness, 3, "N/m")
        self.turn_stiffness = one_each("turn_stiffness", turn_stiffness, 3, "N m/rad")
        self.posture_stiffness = positive("posture_stiffness", posture_stiffness, "N m/rad")
        self.force_limit = limit("force_limit", force_limit, "N")
        self._most = self.force_limit / float(np.sqrt(self.stiffness.max()))

    def pull(self, sms: SpaceManipulator, now: Apart, wanted: Any = None) -> Pull:
        """Return the effect of the spring on the joints of `now.first`.

        `wanted` (pinocchio.SE3) replaces the pose of `now.second`.
        """
        first, second = now.first, now.second
        if wanted is None:
            place = first.com + now.turn @ (second.pose.translation - second.com)
            wanted = pin.SE3(now.turn @ second.pose.rotation, place)
        off = wanted.inverse() * first.pose
        e, phi = off.translation, pin.log3(off.rotation)
        pushed = self.stiffness * e
        s = float(np.sqrt(e @ pushed))
        share = min(1.0, self._most / s) if s > 0.0 else 1.0
        J = dynamics.frame_jacobian(sms, first.q) @ first.N
        axes = first.pose.rotation
        moment = pin.Jlog3(off.rotation).T @ (self.turn_stiffness * phi)
        torque = -(share * (wanted.rotation @ pushed) @ J[:3]) - (axes @ moment) @ J[3:]
        K = J[:3].T @ ((wanted.rotation * self.stiffness) @ wanted.rotation.T) @ J[:3]
        K += J[3:].T @ ((axes * self.turn_stiffness) @ axes.T) @ J[3:]
        free = _free(J)
        wound = free @ now.wound
        k = self.posture_stiffness
        energy = s * s / 2.0 if share == 1.0 else self._most * (s - self._most / 2.0)
        energy += float(phi @ (self.turn_stiffness * phi) + k * (wound @ wound)) / 2.0
        return Pull(torque - k * wound, K + k * free, energy, J, axes, wound)


def _free(J: FloatArray) -> FloatArray:
    """Return the projector (n, n) onto the joint rates in the nullspace of the end effector."""
    _, sigma, Vt = np.linalg.svd(J)
    rank = int(np.count_nonzero(sigma > NULL_SPACE_TOLERANCE * sigma[0]))
    free: FloatArray = Vt[rank:].T @ Vt[rank:]
    return free


def modal_damping(H: FloatArray, K: FloatArray, ratio: float) -> FloatArray:
    """Return D (n, n) >= 0 that gives all modes of H x'' + D x' + K x = 0 one damping ratio.

    Source: A. Albu-Schaeffer, C. Ott, U. Frese, G. Hirzinger, "Cartesian impedance control of redundant
    robots: recent results with the DLR-light-weight-arms", ICRA (2003).
    """
    from scipy.linalg import eigh  # slow to load

    squares, modes = eigh(K, H, check_finite=False)
    spread = H @ modes
    D: FloatArray = (spread * (2.0 * ratio * np.sqrt(np.maximum(squares, 0.0)))) @ spread.T
    return D
