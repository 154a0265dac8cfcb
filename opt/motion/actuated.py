"""What wheels and thrusters that hold the base do along motions.

Wheels that hold the attitude share by the pseudo-inverse, as `ffsms_pin.control.WheelAllocation` does. No
moment acts on the system from outside then, so its angular momentum about its centre of mass is constant:
what the arm and the moving base have of it, the wheels lose. With D the angular momentum a joint rate
(`held_momentum`), A the axes (3, w) and h_0 the wheels' momenta with the joints at rest,

    h = h_0 - A^+ D u,    h' = -A^+ (D u)';

a motor also has to overcome its bearing's friction.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ffsms_pin.actuation import ReactionWheels
from ffsms_pin.actuation.allocation import ThrusterAllocation
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.motion.motions import Motions, apply_rates
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.batch.arm import ArmValues
from ffsms_pin.system.batch.stacks import cross

__all__ = [
    "arm_momentum",
    "friction_slope",
    "held_momentum",
    "nodal_momentum",
    "propellant",
    "wheel_energy",
    "wheel_momentum",
    "wheel_shares",
    "wheel_torque",
    "wheel_total",
]


def wheel_shares(wheels: ReactionWheels) -> FloatArray:
    """A^+ (w, 3): the wheels' shares of a momentum or a torque in root axes."""
    return np.linalg.pinv(wheels.axes.T)


def held_momentum(arm: ArmValues) -> FloatArray:
    """D (3, n, ...): angular momentum a joint rate about the system's centre of mass, base axes.

    The base's attitude held, its place free or held: moving on evenly, a system has none about its own centre
    of mass.
    """
    return arm.angular - cross(arm.com[:, None], arm.linear)


def arm_momentum(motions: Motions) -> FloatArray:
    """D u (3, S, K): angular momentum of arm and base while the attitude is held [N m s], base axes."""
    return apply_rates(held_momentum(motions.arm), motions.rates)


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


def wheel_momentum(motions: Motions) -> FloatArray:
    """Spin momenta h (w, S, K) of the wheels against the base [N m s]; no rows where no wheels hold it."""
    if motions.wheels is None:
        return np.zeros((0, *motions.rates.shape[1:]))
    taken = np.einsum("wx,xsk->wsk", wheel_shares(motions.wheels), arm_momentum(motions))
    return np.asarray(motions.wheel_total[:, None, None] - taken)


def wheel_torque(motions: Motions) -> FloatArray:
    """Motor torques (w, S, K) [N m], friction made good."""
    wheels = motions.wheels
    if wheels is None:
        return np.zeros((0, *motions.rates.shape[1:]))
    torque = -np.einsum("wx,xsk->wsk", wheel_shares(wheels), motions.forces[-3:])
    if wheels.rubs:
        speed = np.moveaxis(wheel_momentum(motions), 0, -1) / wheels.inertia
        torque = torque - np.moveaxis(wheels.friction_torque(speed), -1, 0)
    return np.asarray(torque)


def friction_slope(wheels: ReactionWheels, momentum: FloatArray) -> FloatArray:
    """How the torque that friction takes grows with the momenta (w, S, K) of the wheels [1/s]."""
    inertia, coulomb, viscous = (x[:, None, None] for x in (wheels.inertia, wheels.coulomb, wheels.friction))
    ratio = momentum / inertia / wheels.transition
    dry = coulomb / wheels.transition / np.cosh(np.minimum(np.abs(ratio), 300.0)) ** 2
    return np.asarray((viscous + dry) / inertia)


def nodal_momentum(motion: Motions, sms: SpaceManipulator) -> FloatArray:
    """Momenta (N + 1, w) of the robot's wheels at the nodes of a finished motion [N m s]."""
    if motion.wheels is None:  # wheels that hold nothing stand still
        return np.zeros((len(motion.times) // 2 + 1, len(sms.wheels or ())))
    return wheel_momentum(motion)[:, 0, ::2].T


def wheel_energy(motion: Motions) -> float:
    """Integral over one motion of the sum of |motor torque x wheel speed| [J], by its steps' middles."""
    if motion.wheels is None:
        return 0.0
    momentum, torque = (x(motion)[:, 0, 1::2] for x in (wheel_momentum, wheel_torque))
    power = np.abs(torque * momentum / motion.wheels.inertia[:, None])
    return float(power.sum()) * float(motion.times[2] - motion.times[0])


def propellant(motion: Motions) -> float:
    """What thrusters that hold the base use over one motion [kg], by the law's own sharing of forces.

    As proportional thrusters would give them; pulses of the same mean use the same.
    """
    thrusters = motion.thrusters
    if thrusters is None:
        return 0.0
    allocation = ThrusterAllocation(thrusters, motion.stack.base_com)
    wrenches = motion.forces[-6:, 0, 1::2].T
    flow = [thrusters.flow(allocation.forces(row[:3], row[3:])) for row in wrenches]
    return float(np.sum(flow)) * float(motion.times[2] - motion.times[0])
