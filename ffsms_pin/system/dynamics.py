"""Poses, Jacobians, inertia, velocity-dependent forces, momentum, energy and accelerations, as functions.

M, N and `effects` are in Pinocchio's velocity coordinates (root frame, its own axes); what the joints see
while the base reacts follows from N = [-M_b^-1 M_bm; I], whatever the coordinates of the base's velocity.
Twists are in inertial axes, ordered [linear; angular]. The base's reference point is the centre of mass of
the base body, the end effector's the origin of its frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray, frozen
from ffsms_pin.system.base_reaction import joint_torques, over_base
from ffsms_pin.system.mechanism import Mechanism, scratch

_AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


@dataclass(frozen=True, eq=False)
class Frame:
    """A frame of the robot at a state, inertial axes; its twist is that of the frame's origin.

    Attributes
    ----------
    pose : pinocchio.SE3
    J : ndarray, shape (6, n)
        Twist a joint rate with the base held still.
    J_star : ndarray, shape (6, n)
        The same with the base reacting, at zero momentum: the generalised Jacobian.
    """

    pose: Any
    J: FloatArray
    J_star: FloatArray


def at_origin(q: FloatArray) -> FloatArray:
    """Copy of q (nq,) with the root at the inertial origin.

    For all that does not depend on where the root is: sums about the origin lose digits with the square of
    the distance.
    """
    moved = q.copy()
    moved[:3] = 0.0
    return moved


def base_pose(robot: Mechanism, q: FloatArray) -> Any:
    """Return the pose of the base (pinocchio.SE3): the root's axes, at the base's centre of mass."""
    pose = pin.XYZQUATToSE3(q[:7])
    pose.translation = pose.act(robot.base_com)
    return pose


def frame_pose(robot: Mechanism, q: FloatArray, frame: int | None = None) -> Any:
    """Return the pose of a frame, of the end effector's by default (pinocchio.SE3), at q (nq,)."""
    data = scratch(robot)
    pin.forwardKinematics(robot.model, data, q)
    return pin.updateFramePlacement(robot.model, data, robot.frame_id if frame is None else frame).copy()


def frame_jacobian(robot: Mechanism, q: FloatArray, frame: int | None = None) -> FloatArray:
    """Return the Jacobian (6, 6 + n) of a frame's twist, in Pinocchio's velocity coordinates."""
    frame = robot.frame_id if frame is None else frame
    return np.asarray(pin.computeFrameJacobian(robot.model, scratch(robot), at_origin(q), frame, _AXES))


def inertia_matrix(robot: Mechanism, q: FloatArray) -> FloatArray:
    """Return Pinocchio's inertia matrix M (6 + n, 6 + n) at q (nq,); it depends on the joints alone."""
    return np.asarray(pin.crba(robot.model, scratch(robot), q))


def velocity_effects(robot: Mechanism, q: FloatArray, v: FloatArray) -> FloatArray:
    """Return the generalised force (6 + n,) of Coriolis and centrifugal effects at Pinocchio's v."""
    return np.asarray(pin.nonLinearEffects(robot.model, scratch(robot), q, v))


def reduced_coriolis_matrix(robot: Mechanism, q: FloatArray, N: FloatArray, rates: FloatArray) -> FloatArray:
    """Return the reduced Coriolis matrix C (n, n) [N m s], at joint rates (n,) and zero momentum.

    C qd = C_q where the total momentum is zero, and dH_q/dt - 2 C is skew at any.

    Notes
    -----
    N maps joint rates to the whole velocity, so H_q = N^T M N, and tau = N^T (M dv/dt + C_M v) for v = N qd
    gives H_q qdd + N^T (M dN/dt + C_M N) qd. Only N's base rows change, and N^T M is zero in the base's
    columns, so N^T M dN/dt vanishes and C = N^T C_M N. For the same reason dH_q/dt = N^T (dM/dt) N, so C is
    as skew with it as Pinocchio's C_M is with M (Echeandia and Wensing, "Numerical methods to compute the
    Coriolis matrix and Christoffel symbols for rigid-body systems", Journal of Computational and Nonlinear
    Dynamics 16 (2021)).
    """
    C_M = pin.computeCoriolisMatrix(robot.model, scratch(robot), at_origin(q), N @ rates)
    return np.asarray(N.T @ C_M @ N)


def floating_torque(robot: Mechanism, q: FloatArray, v: FloatArray, qdd: FloatArray) -> FloatArray:
    """Return the torques H_q qdd + C_q (n,) [N m] that accelerate the joints by qdd (n,), the base reacting.

    Without H_q and C_q being made.
    """
    force = pin.rnea(robot.model, scratch(robot), q, v, np.concatenate([np.zeros(6), qdd]))
    return joint_torques(inertia_matrix(robot, q), force)


class Centroidal(NamedTuple):
    """The centre of mass (3,) [m], the momentum (6,) [linear; angular] about it, the kinetic energy [J]."""

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
    """Return the accelerations of base and end effector at zero joint accelerations, the base reacting.

    Nothing acts on the base, so with zero joint accelerations the base rows of the equations of motion give
    the root's acceleration, and one kinematics pass gives the rest. With zero momentum these accelerations
    are dC_bm/dt qd and dJ*/dt qd. Rates of twists (6,) each, inertial axes, of the base's centre of mass and
    of the end effector's origin; the linear part is the classical acceleration of the point, not the spatial
    one.
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
