"""What acts on the arm and on its base along motions: torques of joints, of wheels, and of thrusters.

All forces follow from Newton and Euler, by the compiled kernel (`ffsms_pin/kernel/dynamics.hpp`). Wheels that
hold the attitude share by the pseudo-inverse, as `ffsms_pin.control.WheelAllocation` does. Nothing acts on
the system from outside then, so its angular momentum about its centre of mass is constant: what the arm and
the moving base have of it, the wheels lose. With D the angular momentum a joint rate (`held_momentum`), A the
axes (3, w) and h_0 the wheels' momenta with the joints at rest,

    h = h_0 - A^+ D u,    h' = -A^+ (D u)';

a motor also has to overcome its bearing's friction.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.actuation import ReactionWheels
from ffsms_pin.actuation.allocation import ThrusterAllocation
from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.motion.motions import Motions, apply_rates
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.batch.arm import ArmStack, ArmValues
from ffsms_pin.system.batch.stacks import cross

__all__ = [
    "ForceSlopes",
    "arm_momentum",
    "force_slopes",
    "forces",
    "friction_slope",
    "held_momentum",
    "nodal_momentum",
    "propellant",
    "thruster_shares",
    "wheel_energy",
    "wheel_momentum",
    "wheel_shares",
    "wheel_torque",
    "wheel_total",
]

_STEP = 1e-6  # [rad] of the differences by the joint positions


class ForceSlopes(NamedTuple):
    """Slopes of `forces` by joint positions, rates and accelerations, each (n + 6, n, ...)."""

    by_joints: FloatArray
    by_rates: FloatArray
    by_accelerations: FloatArray


def forces(
    stack: ArmStack,
    joints: FloatArray,
    rates: FloatArray,
    accelerations: FloatArray,
    own_spin: FloatArray | None = None,
) -> FloatArray:
    """Torques of the joints (n, ...) [N m, or N], below them force and moment (6, ...) that hold the base.

    The torques are H_q u' + C_q: the base reacts as far as the mode of the stack leaves it free. What holds
    the base, where something does, is in base axes, the moment about its centre of mass [N, N m].

    Parameters
    ----------
    stack : ArmStack
    joints, rates, accelerations : ndarray, shape (n, ...)
    own_spin : ndarray, shape (3, ...), optional
        What the total momentum adds to the base's angular velocity, base axes [rad/s]. Default: nothing.
    """
    own = np.zeros((3, *joints.shape[1:])) if own_spin is None else own_spin
    found = kernel.dynamics(stack.tree, joints, rates, accelerations, own)
    return found.reshape(-1, *joints.shape[1:])


def force_slopes(
    stack: ArmStack,
    joints: FloatArray,
    rates: FloatArray,
    accelerations: FloatArray,
    own_spin: FloatArray | None = None,
) -> ForceSlopes:
    """Slopes of `forces`; what momentum adds to the spin stays.

    Forces are quadratic in the rates and linear in the accelerations, so differences by these are exact; by
    the joint positions they are central.
    """
    n = stack.n
    # Columns of the identity, one a joint, as a stack of n; then the same backwards.
    ahead = np.eye(n).reshape(n, n, *(1,) * (joints.ndim - 1)) + np.zeros_like(joints)[:, None]
    both = np.concatenate([ahead, -ahead], axis=1)
    q, u, a = (one[:, None] + np.zeros_like(both) for one in (joints, rates, accelerations))
    own = np.zeros((3, *both.shape[1:])) + (0.0 if own_spin is None else own_spin[:, None])
    still = np.zeros_like(both)
    moved = forces(stack, q + _STEP * both, u, a, own)
    faster = forces(stack, q, u + both, still, own)
    pushed = forces(stack, q[:, :n], still[:, :n], ahead)
    return ForceSlopes(
        (moved[:, :n] - moved[:, n:]) / (2.0 * _STEP), 0.5 * (faster[:, :n] - faster[:, n:]), pushed
    )


# -- wheels


def wheel_shares(wheels: ReactionWheels) -> FloatArray:
    """A^+ (w, 3): the wheels' shares of a momentum or a torque in root axes."""
    return np.linalg.pinv(wheels.axes.T)


def held_momentum(arm: ArmValues) -> FloatArray:
    """D (3, n, ...): angular momentum a joint rate about the system's centre of mass, base axes.

    The base's attitude held, its place free or held: moving on evenly, a system has none about its own centre
    of mass.
    """
    return arm.angular - cross(arm.com[:, None], arm.linear)


def wheel_total(
    sms: SpaceManipulator, wheels: ReactionWheels, q: FloatArray, v: FloatArray, momentum: FloatArray
) -> FloatArray:
    """Momenta h_0 (w,) that wheels would have with all else at rest, from those of now (w,) [N m s].

    At a measured state, Pinocchio's q (nq,) and v (6 + n,): what arm and base have of angular momentum, their
    turning as well, is the wheels' in the end.
    """
    angular = pin.computeCentroidalMomentum(sms.model, sms.model.createData(), q, v).angular
    in_root_axes = pin.Quaternion(q[3:7]).toRotationMatrix().T @ angular
    return np.asarray(momentum + wheel_shares(wheels) @ in_root_axes)


def arm_momentum(motions: Motions) -> FloatArray:
    """D u (3, S, K): angular momentum of arm and base while the attitude is held [N m s], base axes."""
    return apply_rates(held_momentum(motions.arm), motions.rates)


def wheel_momentum(motions: Motions) -> FloatArray:
    """Spin momenta h (w, S, K) of the wheels against the base [N m s]; no rows where no wheels hold it."""
    wheels = motions.wheels
    if wheels is None:
        return np.zeros((0, *motions.rates.shape[1:]))
    taken = np.einsum("wx,xsk->wsk", wheel_shares(wheels), arm_momentum(motions))
    return np.asarray(motions.wheel_total[:, None, None] - taken)


def wheel_torque(motions: Motions) -> FloatArray:
    """Motor torques (w, S, K) [N m], friction made good."""
    m, wheels = motions, motions.wheels
    if wheels is None:
        return np.zeros((0, *m.rates.shape[1:]))
    moment = forces(m.stack, m.joints, m.rates, m.accelerations)[-3:]
    torque = -np.einsum("wx,xsk->wsk", wheel_shares(wheels), moment)
    if wheels.rubs:
        speed = wheel_momentum(m) / wheels.inertia[:, None, None]
        torque = torque - np.moveaxis(wheels.friction_torque(np.moveaxis(speed, 0, -1)), -1, 0)
    return np.asarray(torque)


def friction_slope(wheels: ReactionWheels, momentum: FloatArray) -> FloatArray:
    """How the torque that friction takes grows with the momenta (w, S, K) of the wheels [1/s]."""
    inertia, coulomb, viscous = (x[:, None, None] for x in (wheels.inertia, wheels.coulomb, wheels.friction))
    ratio = momentum / inertia / wheels.transition
    dry = coulomb / wheels.transition / np.cosh(np.minimum(np.abs(ratio), 300.0)) ** 2
    return np.asarray((viscous + dry) / inertia)


def nodal_momentum(motion: Motions, sms: SpaceManipulator) -> FloatArray:
    """Momenta (N + 1, w) of the robot's wheels at the nodes of a finished motion [N m s]."""
    nodes = (motion.rates.shape[-1] + 1) // 2
    if motion.wheels is None:  # wheels that hold nothing stand still
        return np.zeros((nodes, 0 if sms.wheels is None else len(sms.wheels)))
    return wheel_momentum(motion)[:, 0, ::2].T


def wheel_energy(motion: Motions) -> float:
    """Integral over one motion of the sum of |motor torque x wheel speed| [J], by its steps' middles."""
    if motion.wheels is None:
        return 0.0
    middles = slice(1, None, 2)
    momentum, torque = wheel_momentum(motion)[:, 0, middles], wheel_torque(motion)[:, 0, middles]
    power = np.abs(torque * momentum / motion.wheels.inertia[:, None]).sum(axis=0)
    return float(power.sum()) * float(motion.times[2] - motion.times[0])


# -- thrusters


def thruster_shares(motions: Motions) -> FloatArray:
    """Rows (r, 6): forces of the thrusters for a unit of each force and moment; parallel ones as one.

    What two thrusters give alike, or one gives and the other takes, is one row with the sum of both.
    """
    assert motions.thrusters is not None
    shares = ThrusterAllocation(motions.thrusters, motions.stack.base_com).shares
    kept: list[FloatArray] = []
    for row in shares:
        size = float(np.linalg.norm(row))
        if size == 0.0:
            continue
        for i, other in enumerate(kept):
            if abs(row @ other) > (1.0 - 1e-9) * size * float(np.linalg.norm(other)):
                kept[i] = other * (1.0 + size / float(np.linalg.norm(other)))
                break
        else:
            kept.append(row)
    return np.array(kept)


def propellant(motion: Motions) -> float:
    """What thrusters that hold the base use over one motion [kg], by the law's own sharing of forces.

    As proportional thrusters would give them; pulses of the same mean use the same.
    """
    thrusters = motion.thrusters
    if thrusters is None:
        return 0.0
    moving = (motion.joints, motion.rates, motion.accelerations)
    wrench = forces(motion.stack, *(x[:, 0, 1::2] for x in moving))[-6:]
    allocation = ThrusterAllocation(thrusters, motion.stack.base_com)
    flow = [thrusters.flow(allocation.forces(row[:3], row[3:])) for row in wrench.T]
    return float(np.sum(flow)) * float(motion.times[2] - motion.times[0])
