"""What wheels that hold the base's attitude have to take up, along whole motions.

Nothing acts on the system from outside, so its angular momentum about its centre of mass is constant: what
the arm and the moving base have of it, the wheels lose. With the attitude held their axes stand still, and
with D the angular momentum a joint rate (`held_momentum`), A the axes (3, w) and h_0 the wheels' momenta
with the joints at rest,

    h = h_0 - A^+ D u,    h' = -A^+ (D u' + K u),    K = d(D u)/dq:

wheels share by the pseudo-inverse, as `ffsms_pin.control.WheelAllocation` does. A motor also has to overcome
its bearing's friction.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ffsms_pin.actuation import ReactionWheels
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.motion.motions import Motions, apply_rates
from ffsms_pin.opt.motion.slopes import momentum_slopes
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.batch.arm import ArmValues
from ffsms_pin.system.batch.stacks import cross
from ffsms_pin.system.mechanism import Mechanism

__all__ = [
    "TorqueSlopes",
    "arm_momentum",
    "arm_torque",
    "friction_slope",
    "held_momentum",
    "momentum_slopes_by_joints",
    "nodal_momentum",
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


def arm_torque(motions: Motions) -> FloatArray:
    """D u' + K u (3, S, K): what holding the attitude takes [N m], base axes."""
    slopes = momentum_slopes(motions.stack, motions.arm, motions.rates)
    return apply_rates(held_momentum(motions.arm), motions.accelerations) + apply_rates(slopes, motions.rates)


def momentum_slopes_by_joints(motions: Motions) -> tuple[FloatArray, FloatArray]:
    """K and D (3, n, S, K): slopes of `arm_momentum` by the joint positions and rates."""
    return momentum_slopes(motions.stack, motions.arm, motions.rates), held_momentum(motions.arm)


def wheel_momentum(motions: Motions) -> FloatArray:
    """Spin momenta h (w, S, K) of the wheels against the base [N m s]; no rows where no wheels hold it."""
    wheels = motions.wheels
    if wheels is None:
        return np.zeros((0, *motions.rates.shape[1:]))
    taken = np.einsum("wx,xsk->wsk", wheel_shares(wheels), arm_momentum(motions))
    return np.asarray(motions.wheel_total[:, None, None] - taken)


def wheel_torque(motions: Motions, momentum: FloatArray | None = None) -> FloatArray:
    """Motor torques (w, S, K) [N m], friction made good; `momentum` is `wheel_momentum`, where known."""
    wheels = motions.wheels
    if wheels is None:
        return np.zeros((0, *motions.rates.shape[1:]))
    torque = -np.einsum("wx,xsk->wsk", wheel_shares(wheels), arm_torque(motions))
    if wheels.rubs:
        h = wheel_momentum(motions) if momentum is None else momentum
        speed = h / wheels.inertia[:, None, None]
        torque = torque - np.moveaxis(wheels.friction_torque(np.moveaxis(speed, 0, -1)), -1, 0)
    return np.asarray(torque)


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


def friction_slope(wheels: ReactionWheels, momentum: FloatArray) -> FloatArray:
    """How the torque that friction takes grows with the momenta (w, S, K) of the wheels [1/s]."""
    inertia, coulomb, viscous = (x[:, None, None] for x in (wheels.inertia, wheels.coulomb, wheels.friction))
    ratio = momentum / inertia / wheels.transition
    dry = coulomb / wheels.transition / np.cosh(np.minimum(np.abs(ratio), 300.0)) ** 2
    return np.asarray((viscous + dry) / inertia)


class TorqueSlopes:
    """Slopes of `arm_torque` at single configurations, by Pinocchio's centroidal derivatives.

    Only instants at which a wheel asks for too much need them: there are few, so a call each will do.

    Reference: J. Carpentier, N. Mansard, "Analytical derivatives of rigid body dynamics algorithms",
    Robotics: Science and Systems (2018).

    Parameters
    ----------
    sms : Mechanism
    """

    def __init__(self, sms: Mechanism) -> None:
        self._model, self._layout = sms.model, sms.layout
        self._q = pin.neutral(sms.model)
        self._n = sms.n

    def at(
        self, joints: FloatArray, rates: FloatArray, accelerations: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """By joint positions, rates and accelerations, each (3, n, V), of columns (n, V) each."""
        model, data, count = self._model, self._model.createData(), joints.shape[1]
        found = np.empty((3, 3, self._n, count))
        q, v, a = self._q.copy(), np.zeros(model.nv), np.zeros(model.nv)
        for i in range(count):
            self._layout.set_positions(q, joints[:, i])
            v[6:], a[6:] = rates[:, i], accelerations[:, i]
            # Held in place or moving evenly: about the centre of mass it is the same.
            _, *slopes = pin.computeCentroidalDynamicsDerivatives(model, data, q, v, a)
            for kind, slope in enumerate(slopes):
                found[kind, ..., i] = slope[3:, 6:]
        return found[0], found[1], found[2]
