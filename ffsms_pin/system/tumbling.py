"""How the base of a system with momentum moves under given joint motion.

Two things are constant in inertial axes: the linear momentum p and the angular momentum h about the system's
centre of mass. So the centre of mass moves by dt p / m, exactly, and what is left is the attitude R, whose
angular velocity in base axes is

    omega(t, R) = K_w(joints) rates + I(joints)^-1 R^T h,

I being the inertia of the whole system about its centre of mass. It depends on R, so Magnus' quadrature does
not do; one Runge-Kutta-Munthe-Kaas step of order 4 in the chart R(t) = R(0) exp(u) does.

Reference: H. Munthe-Kaas, "High order Runge-Kutta methods on manifolds", Applied Numerical Mathematics 29
(1999).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin import lapack
from ffsms_pin.checks import FloatArray
from ffsms_pin.system.base_reaction import WholeBody, cross_matrix, root_velocity, whole_body
from ffsms_pin.system.dynamics import inertia_matrix
from ffsms_pin.system.mechanism import Mechanism

__all__ = ["moved_root"]


class _Spin(NamedTuple):
    """What decides the angular velocity at one instant, in root axes.

    `reaction` (3,) is the angular velocity that the joint rates give, `whole` the system as one rigid body.
    """

    reaction: FloatArray
    whole: WholeBody


def moved_root(
    robot: Mechanism,
    pose: Any,
    joints_at: Callable[[float], tuple[FloatArray, FloatArray]],
    dt: float,
    momentum: FloatArray,
) -> Any:
    """Pose of the root (pinocchio.SE3) one step later.

    Parameters
    ----------
    robot : Mechanism
    pose : pinocchio.SE3
        Of the root at the step's start.
    joints_at : callable
        Gives, for a time since the step's start [s], a configuration (nq,) whose joints are those of that
        time (its base does not matter), and the joint rates (n,).
    dt : float
        [s]
    momentum : ndarray, shape (6,)
        [linear; angular], inertial axes, about the system's centre of mass.
    """
    start, middle, end = (_spin(robot, *joints_at(t)) for t in (0.0, 0.5 * dt, dt))
    h = pose.rotation.T @ momentum[3:]  # in the axes that the root had at the start

    def slope(spin: _Spin, u: FloatArray) -> FloatArray:
        """Rate of the chart's coordinates: the inverse of the exponential's derivative, to order 4."""
        _, own, _ = lapack.dposv(spin.whole.inertia, pin.exp3(u).T @ h)
        omega, turn = spin.reaction + own, cross_matrix(u)
        bracket = turn @ omega
        rate: FloatArray = omega + 0.5 * bracket + (turn @ bracket) / 12.0
        return rate

    k1 = slope(start, np.zeros(3))
    k2 = slope(middle, 0.5 * dt * k1)
    k3 = slope(middle, 0.5 * dt * k2)
    k4 = slope(end, dt * k3)
    rotation = pose.rotation @ pin.exp3(dt / 6.0 * (k1 + 2.0 * (k2 + k3) + k4))

    com = pose.act(start.whole.com) + (dt / start.whole.mass) * momentum[:3]
    return pin.SE3(rotation, com - rotation @ end.whole.com)


def _spin(robot: Mechanism, q: FloatArray, rates: FloatArray) -> _Spin:
    M = inertia_matrix(robot, q)
    return _Spin(root_velocity(M, rates)[3:], whole_body(M))
