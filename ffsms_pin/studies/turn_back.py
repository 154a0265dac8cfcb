"""What holding or turning the base takes of wheels and thrusters: momentum, torque, energy, propellant."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.actuation import ReactionWheels
from ffsms_pin.actuation.allocation import ThrusterAllocation
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt import Trajectory
from ffsms_pin.system import SpaceManipulator
from ffsms_pin.system.base_reaction import whole_body
from ffsms_pin.system.dynamics import inertia_matrix

__all__ = ["Spent", "held_torque", "spent", "turn_back"]

_SAMPLES = 401
_IN_HAND = 0.08  # share of the wheels' limits that turning back leaves for the feedback
_LONGER = 1.05


class Spent(NamedTuple):
    """What wheels and thrusters do along a motion.

    Attributes
    ----------
    t : ndarray, shape (K,)
        [s]
    momentum, torque : ndarray, shape (K, w)
        Of the wheels [N m s], and of their motors [N m].
    energy : float
        Integral of the sum of |motor torque x wheel speed| [J]: nothing is won back in braking.
    propellant : float
        [kg]
    """

    t: FloatArray
    momentum: FloatArray
    torque: FloatArray
    energy: float
    propellant: float


def held_torque(sms: SpaceManipulator, plan: Trajectory) -> FloatArray:
    """Rate (N + 1, 3) of the angular momentum of arm and base on a plan [N m], axes of the root.

    Along a plan that holds the attitude this is what wheels or thrusters have to give.
    """
    model, data = sms.model, sms.model.createData()
    torque = np.empty((len(plan.t), 3))
    a = np.zeros(model.nv)
    for k in range(len(plan.t)):
        a[6:] = plan.joint_accelerations[min(k, len(plan.t) - 2)]
        # About the centre of mass the base's own linear acceleration does not matter.
        rate = pin.computeCentroidalMomentumTimeVariation(model, data, plan.q[k], plan.v[k], a)
        torque[k] = pin.Quaternion(plan.q[k, 3:7]).toRotationMatrix().T @ rate.angular
    return torque


def turn_back(
    sms: SpaceManipulator, q: FloatArray, attitude: FloatArray, duration: float
) -> tuple[Spent, float]:
    """Turn the base back to an attitude with the arm locked, from rest to rest about one axis.

    The angle follows the cubic of least squared torque. Where the wheels cannot do it in the duration, it
    takes as much longer as they need.

    Parameters
    ----------
    sms : SpaceManipulator
        With wheels or thrusters.
    q : ndarray, shape (nq,)
        Configuration at the start.
    attitude : ndarray, shape (4,)
        Quaternion (x, y, z, w) to turn to.
    duration : float
        [s]

    Returns
    -------
    spent : Spent
    moved : float
        How far the end effector is carried along [m].
    """
    turn = pin.Quaternion(q[3:7]).toRotationMatrix().T @ pin.Quaternion(attitude).toRotationMatrix()
    vector = pin.log3(turn)
    body = whole_body(inertia_matrix(sms, q))
    wanted = body.inertia @ vector  # angular momentum a unit of the angle's share a second
    wheels = sms.wheels
    if wheels is not None:
        duration = max(duration, _shortest(wheels, wanted))
        while not _possible(_by_wheels(wheels, wanted, duration), wheels):
            duration *= _LONGER
        found = _by_wheels(wheels, wanted, duration)
    else:
        t, _, rise = _cubic(duration)
        found = _by_thrusters(sms, t, rise[:, None] * wanted, body.com)
    tip = sms.at(q).end_effector_pose.translation
    com = q[:3] + pin.Quaternion(q[3:7]).toRotationMatrix() @ body.com
    turned = pin.Quaternion(attitude).toRotationMatrix() @ pin.Quaternion(q[3:7]).toRotationMatrix().T
    return found, float(np.linalg.norm(turned @ (tip - com) - (tip - com)))


def spent(sms: SpaceManipulator, plan: Trajectory) -> Spent:
    """What a plan asks of wheels or thrusters: nothing while the base floats."""
    w = plan.wheel_momentum.shape[1]
    still = Spent(plan.t, np.zeros((len(plan.t), w)), np.zeros((len(plan.t), w)), 0.0, 0.0)
    held = bool((plan.base_rotation < 1e-9).all()) and bool((np.abs(plan.v[:, 3:6]) < 1e-12).all())
    if not held:
        return still
    torque = held_torque(sms, plan)
    if sms.wheels is not None:
        rise = -torque @ np.linalg.pinv(sms.wheels.axes.T).T
        return _of_wheels(sms.wheels, plan.t, plan.wheel_momentum, rise)
    return still if sms.thrusters is None else _by_thrusters(sms, plan.t, torque, None)


def _cubic(duration: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Instants, rate and acceleration of 3 s^2 - 2 s^3."""
    s = np.linspace(0.0, 1.0, _SAMPLES)
    return duration * s, 6.0 * (s - s**2) / duration, 6.0 * (1.0 - 2.0 * s) / duration**2


def _by_wheels(wheels: ReactionWheels, wanted: FloatArray, duration: float) -> Spent:
    """The total momentum stays zero: what the base gets, the wheels lose."""
    t, rate, rise = _cubic(duration)
    shares = np.linalg.pinv(wheels.axes.T) @ wanted
    return _of_wheels(wheels, t, -rate[:, None] * shares, -rise[:, None] * shares)


def _shortest(wheels: ReactionWheels, wanted: FloatArray) -> float:
    """The least duration without friction [s]: peaks are 1.5 / T of the rate and 6 / T^2 of its rise."""
    shares = np.abs(np.linalg.pinv(wheels.axes.T) @ wanted) / (1.0 - _IN_HAND)
    by_momentum = 1.5 * float((shares / wheels.momentum).max())
    return max(by_momentum, float(np.sqrt(6.0 * (shares / wheels.torque).max())))


def _possible(found: Spent, wheels: ReactionWheels) -> bool:
    """Whether wheels have the torque, friction included."""
    return bool((np.abs(found.torque) <= wheels.torque).all()) or bool(
        (wheels.torque <= _rubbing(wheels)).any()
    )


def _rubbing(wheels: ReactionWheels) -> FloatArray:
    """The torque that friction takes at most: where it leaves none, no duration would do."""
    fastest = np.where(np.isfinite(wheels.momentum), wheels.momentum, 0.0) / wheels.inertia
    return np.asarray(wheels.friction * fastest + wheels.coulomb)


def _of_wheels(wheels: ReactionWheels, t: FloatArray, momentum: FloatArray, rise: FloatArray) -> Spent:
    speed = momentum / wheels.inertia
    torque = rise - wheels.friction_torque(speed)
    return Spent(t, momentum, torque, float(np.trapezoid(np.abs(torque * speed).sum(axis=1), t)), 0.0)


def _by_thrusters(
    sms: SpaceManipulator, t: FloatArray, torque: FloatArray, centre: FloatArray | None
) -> Spent:
    """By pure moments (K, 3) on the base; proportional forces, whatever the thrusters are."""
    none = np.zeros((len(t), 0))
    if sms.thrusters is None:
        return Spent(t, none, none, 0.0, 0.0)
    allocation = ThrusterAllocation(sms.thrusters, sms.base_com if centre is None else centre)
    zero = np.zeros(3)
    flow = np.array([sms.thrusters.flow(allocation.forces(zero, row)) for row in torque])
    return Spent(t, none, none, 0.0, float(np.trapezoid(flow, t)))
