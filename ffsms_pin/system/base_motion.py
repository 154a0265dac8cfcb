"""How the floating base moves under given joint motion: the momentum equation, integrated on SE(3).

With zero momentum the root's velocity in its own axes is K(joints) times the joint rates, and K does not
depend on where the base is. So along a known joint motion it is a known function of time, and one Magnus
step of order 4 (two Gauss points and one Lie bracket) carries the pose over a time step: exact for planar
motion up to quadrature, and without drift of the quaternion. With momentum the velocity depends on the
attitude as well: see `tumbling`.

Reference: A. Iserles, H. Munthe-Kaas, S. Norsett, A. Zanna, "Lie-group methods", Acta Numerica 9 (2000).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, vector
from ffsms_pin.system.base_reaction import mode_reaction, root_velocity
from ffsms_pin.system.dynamics import inertia_matrix
from ffsms_pin.system.manipulator import SpaceManipulator
from ffsms_pin.system.tumbling import moved_root

__all__ = ["advance", "held_velocity", "roll_out"]

_GAUSS = (0.5 - math.sqrt(3.0) / 6.0, 0.5 + math.sqrt(3.0) / 6.0)
_BRACKET = math.sqrt(3.0) / 12.0


def advance(
    sms: SpaceManipulator,
    q: FloatArray,
    rates: FloatArray,
    accelerations: FloatArray,
    dt: float,
    momentum: ArrayLike | None = None,
    mode: str = "floating",
) -> tuple[FloatArray, FloatArray]:
    """Carry a system over one step of constant joint accelerations.

    Parameters
    ----------
    sms : SpaceManipulator
    q : ndarray, shape (nq,)
    rates, accelerations : ndarray, shape (n,)
        Joint rates at the start [rad/s], joint accelerations during the step [rad/s^2].
    dt : float
        [s]
    momentum : array_like, shape (6,), optional
        Total momentum [linear; angular], inertial axes, about the system's centre of mass
        [kg m/s; kg m^2/s]; it is constant. Default zero.
    mode : str
        What of the base is held, one of `ffsms_pin.system.base_reaction.MODES`.

    Returns
    -------
    q : ndarray, shape (nq,)
        At the end of the step; the joints exactly, the base to order 4 (with momentum, the system's centre of
        mass to rounding).
    rates : ndarray, shape (n,)
    """
    total = _momentum(momentum)
    if total is not None and mode == "floating":
        return _advance_tumbling(sms, q, rates, accelerations, dt, total)
    positions = sms.layout.positions(q)
    trial = q.copy()
    twists: list[Any] = []
    for c in _GAUSS:
        h = c * dt
        sms.layout.set_positions(trial, positions + h * (rates + (0.5 * h) * accelerations))
        there = rates + h * accelerations
        if mode == "floating":
            twists.append(pin.Motion(root_velocity(inertia_matrix(sms, trial), there)))
        else:
            twists.append(pin.Motion(held_velocity(sms, trial, there, total, mode)))
    first, second = twists
    twist = (0.5 * dt) * (first + second) + (_BRACKET * dt * dt) * first.cross(second)
    pose = pin.XYZQUATToSE3(q[:7]) * pin.exp6(twist)
    end = rates + dt * accelerations
    result = q.copy()
    result[:7] = pin.SE3ToXYZQUAT(pose)
    # Else rounding grows: a quaternion off unit length makes a matrix that is off a rotation by more.
    result[3:7] /= math.sqrt(result[3:7] @ result[3:7])
    sms.layout.set_positions(result, positions + (0.5 * dt) * (rates + end))
    return result, end


def held_velocity(
    sms: SpaceManipulator, q: FloatArray, rates: FloatArray, momentum: FloatArray | None, mode: str
) -> FloatArray:
    """Root velocity (6,) in root axes, in a mode that holds the attitude or the place of the base.

    Parameters
    ----------
    sms : SpaceManipulator
    q, rates : ndarray, shape (nq,), (n,)
    momentum : ndarray, shape (6,), or None
        Total momentum; only the linear part of a base that keeps its attitude moves it.
    mode : str
        One of `ffsms_pin.system.base_reaction.MODES`, but "floating".
    """
    M = inertia_matrix(sms, q)
    velocity: FloatArray = mode_reaction(M, sms.base_com, mode) @ rates
    if momentum is not None:
        velocity[:3] += pin.Quaternion(q[3:7]).toRotationMatrix().T @ momentum[:3] / M[0, 0]
    return velocity


def _momentum(momentum: ArrayLike | None) -> FloatArray | None:
    """The momentum, None where there is none."""
    if momentum is None:
        return None
    total = vector("momentum", momentum, 6)
    return total if total.any() else None


def _advance_tumbling(
    sms: SpaceManipulator,
    q: FloatArray,
    rates: FloatArray,
    accelerations: FloatArray,
    dt: float,
    momentum: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    positions, trial = sms.layout.positions(q), q.copy()

    def joints_at(t: float) -> tuple[FloatArray, FloatArray]:
        sms.layout.set_positions(trial, positions + t * (rates + (0.5 * t) * accelerations))
        return trial, rates + t * accelerations

    pose = moved_root(sms, pin.XYZQUATToSE3(q[:7]), joints_at, dt, momentum)
    end = rates + dt * accelerations
    result = q.copy()
    result[:7] = pin.SE3ToXYZQUAT(pose)
    # Else rounding grows: a quaternion off unit length makes a matrix that is off a rotation by more.
    result[3:7] /= math.sqrt(result[3:7] @ result[3:7])
    sms.layout.set_positions(result, positions + (0.5 * dt) * (rates + end))
    return result, end


def roll_out(
    sms: SpaceManipulator,
    q: FloatArray,
    rates: FloatArray,
    accelerations: FloatArray,
    dt: float,
    momentum: ArrayLike | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Configurations (N + 1, nq) and joint rates (N + 1, n) under accelerations (N, n), each held for dt.

    `momentum` (6,) as in `advance`.
    """
    total = _momentum(momentum)
    steps = accelerations.shape[0]
    configurations, all_rates = np.empty((steps + 1, sms.nq)), np.empty((steps + 1, sms.n))
    configurations[0], all_rates[0] = q, rates
    for k in range(steps):
        configurations[k + 1], all_rates[k + 1] = advance(
            sms, configurations[k], all_rates[k], accelerations[k], dt, total
        )
    return configurations, all_rates
