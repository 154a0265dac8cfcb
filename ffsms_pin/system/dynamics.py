"""Functions for poses, inertia, momentum, accelerations, and the reaction of the base to joint motion.

The inertia matrix M, N = [-M_b^-1 M_bm; I] and the velocity effects (the Coriolis and centrifugal force) are
in Pinocchio's velocity coordinates. The reduced inertia matrix H_q and the reduced Coriolis and centrifugal
torque C_q follow from N and do not depend on the coordinates of the base's velocity. Twists are in inertial
axes, ordered [linear; angular]. The reference points of the twists are the base body's centre of mass and the
origin of the end-effector frame.

No external force acts on a floating base, so the momentum of the system is constant. With Pinocchio's inertia
matrix M = [[M_b, M_bm], [M_bm^T, M_m]], root velocity v_b and joint rates qd, the momentum about the root
frame's origin is h = M_b v_b + M_bm qd in root axes. Therefore

    v_b = -M_b^-1 M_bm qd + M_b^-1 h.

M and the matrices that are computed from M alone depend on the joint positions only.

Pinocchio's base velocity v_b is that of the root frame's origin, in root axes. The paper's base twist x_b is
that of the base's centre of mass, in inertial axes. With the base's attitude R and centre of mass c in the
root frame, v_b = A x_b, where A = [[R^T, [c]x R^T], [0, R^T]] is the action on motions of the rigid
transformation (R^T, c).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray, frozen, one_of
from ffsms_pin.system.mechanism import Mechanism, scratch

_AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


@dataclass(frozen=True, eq=False)
class Frame:
    """The pose and Jacobians of a frame at a state, in inertial axes.

    The twists [linear; angular] are those of the frame's origin.

    Attributes
    ----------
    pose : pinocchio.SE3
        Pose of the frame.
    J : ndarray, shape (6, n)
        Twist per joint rate with the base fixed.
    J_star : ndarray, shape (6, n)
        Twist per joint rate on a free-floating base at zero momentum: the generalised Jacobian.
    """

    pose: Any
    J: FloatArray
    J_star: FloatArray


def at_origin(q: FloatArray) -> FloatArray:
    """Copy q (nq,) with the root at the inertial origin.

    Quantities that do not depend on the root's position are computed at the inertial origin, because the
    rounding errors of sums about a distant origin grow with the square of the distance.
    """
    moved = q.copy()
    moved[:3] = 0.0
    return moved


def base_pose(robot: Mechanism, q: FloatArray) -> Any:
    """Return the pose of the base (pinocchio.SE3): origin at the base's centre of mass, axes of the root."""
    pose = pin.XYZQUATToSE3(q[:7])
    pose.translation = pose.act(robot.base_com)
    return pose


def frame_pose(robot: Mechanism, q: FloatArray, frame: int | None = None) -> Any:
    """Return the pose (pinocchio.SE3) of a frame at q (nq,), by default the end-effector frame."""
    data = scratch(robot)
    pin.forwardKinematics(robot.model, data, q)
    return pin.updateFramePlacement(robot.model, data, robot.frame_id if frame is None else frame).copy()


def frame_jacobian(robot: Mechanism, q: FloatArray, frame: int | None = None) -> FloatArray:
    """Return the Jacobian (6, 6 + n) from v to the twist of a frame, by default the end-effector frame.

    The velocity v is in Pinocchio's coordinates, and the twist of the frame's origin in inertial axes.
    """
    frame = robot.frame_id if frame is None else frame
    return np.asarray(pin.computeFrameJacobian(robot.model, scratch(robot), at_origin(q), frame, _AXES))


def inertia_matrix(robot: Mechanism, q: FloatArray) -> FloatArray:
    """Return Pinocchio's inertia matrix M (6 + n, 6 + n) at q (nq,)."""
    return np.asarray(pin.crba(robot.model, scratch(robot), q))


def velocity_effects(robot: Mechanism, q: FloatArray, v: FloatArray) -> FloatArray:
    """Return the generalised Coriolis and centrifugal force (6 + n,) at Pinocchio's q and v."""
    return np.asarray(pin.nonLinearEffects(robot.model, scratch(robot), q, v))


def reduced_coriolis_matrix(robot: Mechanism, q: FloatArray, N: FloatArray, rates: FloatArray) -> FloatArray:
    """Return the reduced Coriolis matrix C (n, n), from N (6 + n, n) and joint rates qd (n,).

    C qd = C_q if the total momentum is zero; dH_q/dt - 2 C is skew-symmetric at any momentum.

    Notes
    -----
    N maps joint rates to Pinocchio's velocity v = N qd, and C_M is Pinocchio's Coriolis matrix. Then
    tau = N^T (M dv/dt + C_M v) = H_q qdd + N^T (M dN/dt + C_M N) qd with H_q = N^T M N. Only the base rows of
    N change, and N^T M is zero in the base's columns, so N^T M dN/dt = 0 and C = N^T C_M N. For the same
    reason dH_q/dt = N^T (dM/dt) N. Hence dH_q/dt - 2 C = N^T (dM/dt - 2 C_M) N, which is skew-symmetric
    because dM/dt - 2 C_M is skew-symmetric.

    Reference for C_M: S. Echeandia and P. M. Wensing, "Numerical methods to compute the Coriolis matrix and
    Christoffel symbols for rigid-body systems", Journal of Computational and Nonlinear Dynamics 16 (2021).
    """
    C_M = pin.computeCoriolisMatrix(robot.model, scratch(robot), at_origin(q), N @ rates)
    return np.asarray(N.T @ C_M @ N)


def floating_torque(robot: Mechanism, q: FloatArray, v: FloatArray, qdd: FloatArray) -> FloatArray:
    """Return the joint torques H_q qdd + C_q (n,) [N m or N] for joint accelerations qdd (n,).

    The base floats freely. The recursive Newton-Euler algorithm is used, so no Coriolis matrix is needed.
    """
    force = pin.rnea(robot.model, scratch(robot), q, v, np.concatenate([np.zeros(6), qdd]))
    return joint_torques(inertia_matrix(robot, q), force)


class Centroidal(NamedTuple):
    """The centre of mass (3,) [m], momentum (6,) and kinetic energy [J] of the whole system.

    The momentum [linear; angular] is about the centre of mass, in inertial axes.
    """

    com: FloatArray
    momentum: FloatArray
    kinetic_energy: float


def centroidal(robot: Mechanism, q: FloatArray, v: FloatArray) -> Centroidal:
    """Return the centre of mass, momentum and kinetic energy at q (nq,) and v (6 + n,)."""
    data = scratch(robot)
    momentum = pin.computeCentroidalMomentum(robot.model, data, at_origin(q), v).vector.copy()
    energy = float(pin.computeKineticEnergy(robot.model, data))
    return Centroidal(frozen(q[:3] + data.com[0]), frozen(momentum), energy)


def bias_accelerations(
    robot: Mechanism, M: FloatArray, q: FloatArray, v: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the accelerations (6,) of a floating base and of the end effector at zero joint accelerations.

    The accelerations are the time derivatives, in inertial axes, of the twists of the base's centre of mass
    and of the end-effector frame's origin. The linear parts are classical accelerations of these points, not
    spatial accelerations. At zero momentum the results are dC_bm/dt qd and dJ*/dt qd. The root's acceleration
    follows from the base rows of the equations of motion without an external force.
    """
    model, data = robot.model, scratch(robot)
    acceleration = np.zeros(robot.nv)
    acceleration[:6] = -over_base(M, velocity_effects(robot, q, v)[:6])
    pin.forwardKinematics(model, data, q, v, acceleration)
    end_effector = pin.getFrameClassicalAcceleration(model, data, robot.frame_id, _AXES).vector.copy()
    base = pin.getClassicalAcceleration(model, data, 1, _AXES).vector.copy()
    rotation = data.oMi[1].rotation
    lever, turning = rotation @ robot.base_com, pin.skew(rotation @ v[3:6])
    base[:3] += pin.skew(base[3:]) @ lever + turning @ (turning @ lever)
    return base, end_effector


def root_reaction(M: FloatArray) -> FloatArray:
    """Return -M_b^-1 M_bm (6, n), the root's velocity per joint rate at zero momentum, in root axes."""
    return -over_base(M, M[:6, 6:])


def floating_motion(M: FloatArray) -> FloatArray:
    """Return N = [-M_b^-1 M_bm; I] (6 + n, n), Pinocchio's velocity per joint rate at zero momentum.

    The base rows of M N are zero.
    """
    n = len(M) - 6
    N = np.zeros((6 + n, n))
    N[:6] = root_reaction(M)
    N[6:].flat[:: n + 1] = 1.0  # the diagonal
    return N


def joint_torques(M: FloatArray, force: FloatArray) -> FloatArray:
    """Return the joint torques N^T f (n,) [N m or N] of a robot on a floating base.

    f = [f_b; f_m] (6 + n,) is the generalised force of the motion with the same q, v and joint accelerations,
    but with zero base acceleration. The torques are f_m - M_bm^T M_b^-1 f_b.
    """
    return np.asarray(force[6:] - over_base(M, force[:6]).dot(M[:6, 6:]))


def base_to_root(q: FloatArray, base_com: FloatArray) -> Any:
    """Return the transformation (pinocchio.SE3) from the paper's base twist to Pinocchio's root velocity.

    Its `action` (6, 6) maps a base twist to the root velocity, and its `actionInverse` maps back. `base_com`
    (3,) is the base's centre of mass in the root frame [m].
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
"""The indices of the free rows of the base's twist in each mode. The attitude is held by wheels in
"rotation-floating" and by thrusters in "rotation-flying"; the base's motion is the same in both modes."""


def mode_coupling(H_b: FloatArray, H_bm: FloatArray, mode: str) -> FloatArray:
    """Return C_bm (6, n) of a mode: the base's twist per joint rate at zero momentum.

    The rows of the held motion are zero. No external force acts along the free rows f, so the momentum in
    these rows stays zero, and C_bm[f] = -H_b[f, f]^-1 H_bm[f]. With a held attitude the linear momentum is
    zero; with a held position the angular momentum about the base's centre of mass is zero.

    Reference: M. Wilde, S. Kwok Choon, A. Grompone, M. Romano, "Equations of motion of free-floating
    spacecraft-manipulator systems: an engineer's tutorial", Frontiers in Robotics and AI 5 (2018).
    """
    free = list(MODES[one_of("mode", mode, MODES)])
    coupling = np.zeros_like(H_bm)
    if free:
        coupling[free] = -np.linalg.solve(H_b[np.ix_(free, free)], H_bm[free])
    return coupling


def mode_reaction(M: FloatArray, base_com: FloatArray, mode: str) -> FloatArray:
    """Return the root's velocity per joint rate (6, n) in a mode at zero momentum, in root axes."""
    if mode == "floating":
        return root_reaction(M)
    to_root = _from_base_com(base_com)
    H_b, H_bm = to_root.T @ M[:6, :6] @ to_root, to_root.T @ M[:6, 6:]
    return np.asarray(to_root @ mode_coupling(H_b, H_bm, mode))


def _from_base_com(base_com: FloatArray) -> FloatArray:
    """Return the map (6, 6) from a twist of the base's centre of mass, root axes, to the root's velocity."""
    to_root = np.eye(6)
    to_root[:3, 3:] = pin.skew(base_com)
    return to_root


def root_drift(
    M: FloatArray, q: FloatArray, momentum: FloatArray, base_com: FloatArray, mode: str = "floating"
) -> FloatArray:
    """Return the root velocity (6,), root axes, of a system with the given momentum and resting joints.

    `momentum` (6,) is in inertial axes, about the system's centre of mass. If the mode holds the base's
    attitude, the angular momentum is ignored. If the mode holds the base's position, the linear momentum is
    ignored, and the angular momentum is about the base's centre of mass.
    """
    to_root, whole = pin.XYZQUATToSE3(q[:7]).rotation.T, whole_body(M)
    linear, angular = to_root @ momentum[:3], to_root @ momentum[3:]
    if mode == "floating":
        return over_base(M, np.concatenate([linear, angular + pin.skew(whole.lever) @ linear]))
    # The rows of the momentum that the mode's free twist of the base's centre of mass produces.
    free = _from_base_com(base_com)[:, list(MODES[mode])]
    momentum = np.concatenate([linear, angular])[list(MODES[mode])]
    return np.asarray(free @ np.linalg.solve(free.T @ M[:6, :6] @ free, momentum))


def whole_body(M: FloatArray) -> Any:
    """Return the inertia (pinocchio.Inertia) of the system with locked joints, in the root frame, from M.

    M_b = [[m 1, -m [c]x], [m [c]x, I - m [c]x [c]x]], where m is the mass, c the centre of mass, and I the
    inertia about c.
    """
    mass = float(M[0, 0])
    com = np.array([M[1, 5], M[2, 3], M[0, 4]]) / mass
    arm = pin.skew(com)
    return pin.Inertia(mass, com, M[3:6, 3:6] + mass * (arm @ arm))


def over_base(M: FloatArray, right: FloatArray) -> FloatArray:
    """Return M_b^-1 times a vector (6,) or a matrix (6, k)."""
    return np.asarray(np.linalg.solve(M[:6, :6], right))
