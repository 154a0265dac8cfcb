"""The reaction of the base to the joints, -M_b^-1 M_bm, the part of momentum, and the base's two velocities.

Nothing acts on a floating base, so its momentum is constant. With Pinocchio's inertia matrix
M = [[M_b, M_bm], [M_bm^T, M_m]], root velocity v_b and joint rates qd, the momentum about the root is
M_b v_b + M_bm qd. Where it is zero,

    v_b = -M_b^-1 M_bm qd,

and elsewhere the momentum adds M_b^-1 h. M, and so all of this, depends on the joints alone.

Pinocchio's base velocity is that of the root frame's origin, in the root's own axes. The paper's is that of
the base's centre of mass, in inertial axes. With R the base's attitude and c its centre of mass in the root
frame, v_root = A x_b where A = [[R^T, [c]x R^T], [0, R^T]]: the action on motions of the rigid transformation
(R^T, c).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray, one_of


def root_reaction(M: FloatArray) -> FloatArray:
    """Return -M_b^-1 M_bm (6, n): the root's velocity a joint rate at zero momentum, root axes."""
    return -over_base(M, M[:6, 6:])


def floating_motion(M: FloatArray) -> FloatArray:
    """Return N = [-M_b^-1 M_bm; I] (6 + n, n): Pinocchio's velocity a joint rate at zero momentum.

    M N is zero in the base's rows.
    """
    n = len(M) - 6
    N = np.zeros((6 + n, n))
    N[:6] = root_reaction(M)
    N[6:].flat[:: n + 1] = 1.0  # the diagonal
    return N


def joint_torques(M: FloatArray, force: FloatArray) -> FloatArray:
    """Return N^T f (n,) [N m]: the joints' part of a generalised force f (6 + n,), the base reacting.

    With f the force for a motion that holds the base's acceleration at zero, the base takes up f_b by
    accelerating, and the joints see f_m - M_bm^T M_b^-1 f_b.
    """
    return np.asarray(force[6:] - over_base(M, force[:6]).dot(M[:6, 6:]))


def base_to_root(q: FloatArray, base_com: FloatArray) -> Any:
    """Return the transformation (pinocchio.SE3) from the paper's base twist to Pinocchio's root velocity.

    Its `action` (6, 6) makes the root velocity of a base twist, `actionInverse` the base twist of a root
    velocity. `base_com` (3,) is the base's centre of mass in the root frame [m].
    """
    transformation = pin.XYZQUATToSE3(q[:7]).inverse()
    transformation.translation = base_com
    return transformation


MODES: Mapping[str, tuple[int, ...]] = {
    "floating": (0, 1, 2, 3, 4, 5),
    "rotation-floating": (0, 1, 2),
    "rotation-flying": (0, 1, 2),
    "translation-flying": (3, 4, 5),
    "flying": (),
}
"""Rows of the base's twist that are free, by mode. "rotation-floating" holds the attitude by wheels,
"rotation-flying" by thrusters: the base moves alike."""


def mode_coupling(H_b: FloatArray, H_bm: FloatArray, mode: str) -> FloatArray:
    """Return C_bm (6, n) of a mode: the base's twist a joint rate, without the motion that is held.

    Nothing acts along the rows that are free, so their momentum stays zero: with f these rows,
    C_bm[f] = -H_b[f, f]^-1 H_bm[f], and the others are zero. Where the attitude is held the linear momentum
    is zero; where the base's centre of mass is held, the angular momentum about it.

    Reference: M. Wilde, S. Kwok Choon, A. Grompone, M. Romano, "Equations of motion of free-floating
    spacecraft-manipulator systems: an engineer's tutorial", Frontiers in Robotics and AI 5 (2018).
    """
    free = list(MODES[one_of("mode", mode, MODES)])
    coupling = np.zeros_like(H_bm)
    if free:
        coupling[free] = -np.linalg.solve(H_b[np.ix_(free, free)], H_bm[free])
    return coupling


def mode_reaction(M: FloatArray, base_com: FloatArray, mode: str) -> FloatArray:
    """Return the root's velocity per joint rate (6, n) in a mode, root axes: `mode_coupling` at the root."""
    if mode == "floating":
        return root_reaction(M)
    to_root = np.eye(6)  # of a twist at the base's centre of mass, in root axes
    to_root[:3, 3:] = pin.skew(base_com)
    H_b, H_bm = to_root.T @ M[:6, :6] @ to_root, to_root.T @ M[:6, 6:]
    return np.asarray(to_root @ mode_coupling(H_b, H_bm, mode))


def root_drift(M: FloatArray, q: FloatArray, momentum: FloatArray, mode: str = "floating") -> FloatArray:
    """Return the root velocity (6,), root axes, at which the system has `momentum`, the joints at rest.

    The momentum (6,) is in inertial axes, about the system's centre of mass. A base that keeps its attitude
    is moved by its linear part alone, one that keeps its place by none.
    """
    to_root, whole = pin.XYZQUATToSE3(q[:7]).rotation.T, whole_body(M)
    linear, angular = to_root @ momentum[:3], to_root @ momentum[3:]
    if mode == "floating":
        return over_base(M, np.concatenate([linear, angular + pin.skew(whole.lever) @ linear]))
    return np.concatenate([linear / whole.mass * (0 in MODES[mode]), np.zeros(3)])


def whole_body(M: FloatArray) -> Any:
    """Return the system as one rigid body (pinocchio.Inertia) in the root frame, as M_b describes it.

    That of a rigid body is [[m 1, -m [c]x], [m [c]x, I - m [c]x [c]x]].
    """
    mass = float(M[0, 0])
    com = np.array([M[1, 5], M[2, 3], M[0, 4]]) / mass
    arm = pin.skew(com)
    return pin.Inertia(mass, com, M[3:6, 3:6] + mass * (arm @ arm))


def over_base(M: FloatArray, right: FloatArray) -> FloatArray:
    """Return M_b^-1 times a vector or a matrix."""
    return np.asarray(np.linalg.solve(M[:6, :6], right))
