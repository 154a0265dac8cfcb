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
from ffsms_pin.system.kinetics import cross_matrix

__all__ = ["moved_root"]


class _Spin(NamedTuple):
    """What decides the angular velocity at one instant, and the centre of mass; all in root axes.

    `reaction` (3,) is the angular velocity that the joint rates give, `inertia` (3, 3) that of the whole
    system about its centre of mass `com` (3,).
    """

    reaction: FloatArray
    inertia: FloatArray
    com: FloatArray
    mass: float


def moved_root(
    model: Any,
    data: Any,
    pose: Any,
    joints_at: Callable[[float], tuple[FloatArray, FloatArray]],
    dt: float,
    momentum: FloatArray,
) -> Any:
    """Pose of the root (pinocchio.SE3) one step later.

    Parameters
    ----------
    model, data : pinocchio.Model, pinocchio.Data
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
    start, middle, end = (_spin(model, data, *joints_at(t)) for t in (0.0, 0.5 * dt, dt))
    h = pose.rotation.T @ momentum[3:]  # in the axes that the root had at the start

    def slope(spin: _Spin, u: FloatArray) -> FloatArray:
        """Rate of the chart's coordinates: the inverse of the exponential's derivative, to order 4."""
        _, own, _ = lapack.dposv(spin.inertia, pin.exp3(u).T @ h)
        omega, turn = spin.reaction + own, cross_matrix(u)
        bracket = turn @ omega
        rate: FloatArray = omega + 0.5 * bracket + (turn @ bracket) / 12.0
        return rate

    k1 = slope(start, np.zeros(3))
    k2 = slope(middle, 0.5 * dt * k1)
    k3 = slope(middle, 0.5 * dt * k2)
    k4 = slope(end, dt * k3)
    rotation = pose.rotation @ pin.exp3(dt / 6.0 * (k1 + 2.0 * (k2 + k3) + k4))

    com = pose.act(start.com) + (dt / start.mass) * momentum[:3]
    return pin.SE3(rotation, com - rotation @ end.com)


def _spin(model: Any, data: Any, q: FloatArray, rates: FloatArray) -> _Spin:
    M = pin.crba(model, data, q)
    mass = float(M[0, 0])
    # The blocks of a rigid body's inertia: [[m 1, -m [c]x], [m [c]x, I - m [c]x [c]x]].
    com = np.array([M[1, 5], M[2, 3], M[0, 4]]) / mass
    arm = cross_matrix(com)
    inertia = M[3:6, 3:6] + mass * (arm @ arm)
    _, velocity, _ = lapack.dposv(M[:6, :6], -(M[:6, 6:] @ rates))
    return _Spin(velocity[3:], inertia, com, mass)
