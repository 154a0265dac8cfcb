"""The regressors of momentum and joint torques, which are linear in the bodies' inertial parameters.

The ten parameters of a body are Pinocchio's, in the frame of its joint: mass m, first moments m c (3) with
the centre of mass c, and the inertia about the frame's origin (Ixx, Ixy, Iyy, Ixz, Iyz, Izz). The base comes
first, then the bodies in the order of the joints. With the linear and angular velocity (v, w) of the frame in
its own axes, the momentum of a body about the frame's origin is

    linear = m v + w x (m c),    angular = (m c) x v + I w.

Reference: K. Yoshida and S. Abiko, "Inertia parameter identification for a free-flying space robot", AIAA
Guidance, Navigation, and Control Conference, 2002.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.system.batch.stacks import apply, cross, exp3, rotations, skew
from ffsms_pin.system.dynamics import at_origin
from ffsms_pin.system.mechanism import Mechanism, scratch

PER_BODY = 10


def inertial_parameters(robot: Mechanism) -> FloatArray:
    """Return the parameters (10 (1 + n),) of all bodies, the base first."""
    bodies = list(robot.model.inertias)[1:]
    return np.concatenate([body.toDynamicParameters() for body in bodies])


def pseudo_inertia(parameters: FloatArray) -> FloatArray:
    """Return the pseudo-inertia [[S, m c], [m c^T, m]] (4, 4) of a body's inertial parameters (10,).

    S = tr(I) / 2 - I are the second moments of mass about the frame's origin.
    """
    m, cx, cy, cz, xx, xy, yy, xz, yz, zz = parameters.tolist()
    half = 0.5 * (xx + yy + zz)
    return np.array(
        [[half - xx, -xy, -xz, cx], [-xy, half - yy, -yz, cy], [-xz, -yz, half - zz, cz], [cx, cy, cz, m]]
    )


def parameters_of(P: FloatArray) -> FloatArray:
    """Return the inertial parameters (10,) of a pseudo-inertia (4, 4), the inverse of `pseudo_inertia`."""
    xx, yy, zz = P[1, 1] + P[2, 2], P[0, 0] + P[2, 2], P[0, 0] + P[1, 1]
    return np.array([P[3, 3], *P[:3, 3], xx, -P[0, 1], yy, -P[0, 2], -P[1, 2], zz])


def body_regressor(linear: FloatArray, angular: FloatArray) -> FloatArray:
    """Return the regressor (6, 10, ...) of a body's momentum about its frame's origin, in the frame's axes.

    `linear` and `angular` (3, ...) are the velocity of the frame's origin [m/s] and the angular velocity
    [rad/s].
    """
    Y = np.zeros((6, PER_BODY, *linear.shape[1:]))
    x, y, z = angular
    Y[:3, 0] = linear
    Y[:3, 1:4] = skew(angular)
    Y[3:, 1:4] = -skew(linear)
    Y[3, 4], Y[3, 5], Y[3, 7] = x, y, z
    Y[4, 5], Y[4, 6], Y[4, 8] = x, y, z
    Y[5, 7], Y[5, 8], Y[5, 9] = x, y, z
    return Y


def momentum_regressor(robot: Mechanism, q: FloatArray, v: FloatArray) -> FloatArray:
    """Return the regressor (6, 10 (1 + n)) of the momentum about the system's centre of mass.

    The rows are in inertial axes, ordered [linear; angular]. The centre of mass is computed with the robot's
    own parameters.
    """
    com = pin.centerOfMass(robot.model, scratch(robot), at_origin(q)).copy()
    return np.asarray(momentum_regressors(robot, q[None], v[None], q[:3] + com)[0])


def momentum_regressors(
    robot: Mechanism, q: FloatArray, v: FloatArray, about: FloatArray, bodies: Sequence[int] | None = None
) -> FloatArray:
    """Return the momentum regressors (N, 6, 10 b) of states q (N, nq) and v (N, 6 + n), inertial axes.

    The angular momentum is about the fixed point `about` (3,). `bodies` are the indices of b bodies, 0 for
    the base; default: all bodies.
    """
    chosen = list(range(robot.n + 1) if bodies is None else bodies)
    out = np.empty((len(q), 6, PER_BODY * len(chosen)))
    moved = moving_frames(robot, q, v)
    for k, body in enumerate(chosen):
        frame = moved[body]
        Y = body_regressor(frame.linear, frame.angular)
        linear, angular = apply(frame.rotation, Y[:3]), apply(frame.rotation, Y[3:])
        lever = frame.position - about[:, None]
        angular += apply(skew(lever), linear)
        columns = slice(PER_BODY * k, PER_BODY * (k + 1))
        out[:, :3, columns], out[:, 3:, columns] = np.moveaxis(linear, -1, 0), np.moveaxis(angular, -1, 0)
    return out


class MovingFrames(NamedTuple):
    """The motion of a body's frame in a stack of states.

    Attributes
    ----------
    rotation, position : ndarray, shape (3, 3, N) and (3, N)
        Pose in inertial axes.
    linear, angular : ndarray, shape (3, N)
        Velocity of the frame's origin and angular velocity, in the frame's axes.
    """

    rotation: FloatArray
    position: FloatArray
    linear: FloatArray
    angular: FloatArray


def moving_frames(robot: Mechanism, q: FloatArray, v: FloatArray) -> list[MovingFrames]:
    """Return the motion of each body's frame, the base first, at states q (N, nq) and v (N, 6 + n)."""
    model, layout = robot.model, robot.layout
    q, v = q.T, v.T
    frames = [MovingFrames(rotations(q[3:7]), q[:3], v[:3], v[3:6])]
    first, second = q[layout.index], q[layout.index + layout.continuous]
    positions = np.where(layout.continuous[:, None], np.arctan2(second, first), first)
    for i, (axis, turns) in enumerate(zip(joint_axes(robot), layout.turns, strict=True)):
        parent, place = frames[model.parents[i + 2] - 1], model.jointPlacements[i + 2]
        along = axis[:, None] * positions[i]
        turn, shift = place.rotation[..., None], place.translation[:, None]
        if turns:
            turn = apply(np.broadcast_to(turn, (3, 3, q.shape[1])), exp3(along))
        else:
            turn, shift = np.broadcast_to(turn, (3, 3, q.shape[1])), shift + place.rotation @ along
        back, rate = np.swapaxes(turn, 0, 1), axis[:, None] * v[6 + i]
        linear, angular = (
            apply(back, parent.linear + cross(parent.angular, shift)),
            apply(back, parent.angular),
        )
        linear, angular = (linear, angular + rate) if turns else (linear + rate, angular)
        position = parent.position + apply(parent.rotation, shift)
        frames.append(MovingFrames(apply(parent.rotation, turn), position, linear, angular))
    return frames


def joint_axes(robot: Mechanism) -> list[FloatArray]:
    """Return the unit axes (3,) of the joints, each in the frame of its joint."""
    data = scratch(robot)
    J = pin.computeJointJacobians(robot.model, data, pin.neutral(robot.model))
    axes = []
    for i, turns in enumerate(robot.layout.turns):
        column = J[3:, 6 + i] if turns else J[:3, 6 + i]
        axes.append(np.asarray(data.oMi[i + 2].rotation.T @ column))
    return axes


def torque_regressor(robot: Mechanism, q: FloatArray, v: FloatArray, acceleration: FloatArray) -> FloatArray:
    """Return the regressor (6 + n, 10 (1 + n)) of the generalised force at q, v and `acceleration` (6 + n,).

    The force is in Pinocchio's velocity coordinates. The torques due to the rotors' inertia
    (`model.armature`) are not included.
    """
    Y = pin.computeJointTorqueRegressor(robot.model, scratch(robot), at_origin(q), v, acceleration)
    return np.array(Y)
