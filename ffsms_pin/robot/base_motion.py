"""The integration of the system's motion under given joint accelerations, by the momentum equation.

In inertial axes the linear momentum p and the angular momentum h about the system's centre of mass are
constant. In a step of length dt the centre of mass of a system with mass m therefore moves by exactly
dt p / m, and only the base's attitude R is integrated. The base's angular velocity in base axes is

    omega(t, R) = K_w(joints) rates + I(joints)^-1 R^T h,

where K_w (3, n) is the base's angular velocity per joint rate at zero momentum, and I is the inertia of the
whole system about its centre of mass. Each time step is one Runge-Kutta-Munthe-Kaas step of order 4 in the
chart R(t) = R(0) exp(u), with the attitude R(0) at the start of the step. For planar motion without momentum
the step reduces to Simpson's rule. If a mode (see `dynamics.MODES`) holds the base's position, the system's
mass is taken as infinite, and the angular momentum is about the base's centre of mass. If a mode holds the
base's attitude, the system's inertia is taken as infinite.

Reference: H. Munthe-Kaas, "High order Runge-Kutta methods on manifolds", Applied Numerical Mathematics 29
(1999).
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, vector
from ffsms_pin.kernel import kernel
from ffsms_pin.robot.manipulator import SpaceManipulator
from ffsms_pin.system.batch.stacks import quaternions


def advance(
    sms: SpaceManipulator,
    q: FloatArray,
    rates: FloatArray,
    accelerations: FloatArray,
    dt: float,
    momentum: ArrayLike | None = None,
    mode: str = "floating",
) -> tuple[FloatArray, FloatArray]:
    """Return q (nq,) and joint rates (n,) after one step of `roll_out` with joint accelerations (n,)."""
    states = _states(sms, q, rates, accelerations[:, None], dt, momentum, mode)
    end, n = states[:, 1], sms.n
    result = np.empty(sms.nq)
    result[:3] = end[9:12]
    attitude = pin.Quaternion(end[:9].reshape(3, 3))
    attitude.normalize()
    result[3:7] = attitude.coeffs()
    sms.layout.set_positions(result, end[12 : 12 + n])
    return result, end[12 + n :].copy()


def roll_out(
    sms: SpaceManipulator,
    q: FloatArray,
    rates: FloatArray,
    accelerations: FloatArray,
    dt: float,
    momentum: ArrayLike | None = None,
    mode: str = "floating",
) -> tuple[FloatArray, FloatArray]:
    """Integrate a system from q (nq,) and joint rates (n,) over N steps of joint accelerations (N, n).

    The accelerations are constant in each step of length `dt` [s]. `mode` is a key of `dynamics.MODES`. The
    total momentum (6,), in inertial axes, is about the system's centre of mass, or about the base's centre of
    mass if the mode holds the base's position; default: zero. Returns q (N + 1, nq) and joint rates
    (N + 1, n) at the nodes. Joint positions are exact to rounding; the error of the attitude is of order
    dt^4.
    """
    states, n = _states(sms, q, rates, accelerations.T, dt, momentum, mode), sms.n
    configurations = np.empty((states.shape[1], sms.nq))
    configurations[:, :3] = states[9:12].T
    configurations[:, 3:7] = quaternions(states[:9].reshape(3, 3, -1)).T
    for row, positions in zip(configurations, states[12 : 12 + n].T, strict=True):
        sms.layout.set_positions(row, positions)
    configurations[0] = q
    return configurations, states[12 + n :].T.copy()


def straight_end(
    sms: SpaceManipulator,
    q: FloatArray,
    joints: FloatArray,
    duration: float,
    momentum: ArrayLike | None = None,
    steps: int = 200,
) -> FloatArray:
    """Return the configuration (nq,) at the end of a straight-line joint motion from q to `joints` (n,).

    The motion follows a quintic time profile over the duration [s] and is integrated in `steps` time steps.
    `momentum` is that of `roll_out`.
    """
    s, dt = np.linspace(0.0, 1.0, steps + 1), duration / steps
    displacement = joints - sms.joint_positions(q)
    rates = (displacement / duration) * (30.0 * s**2 * (1.0 - s) ** 2)[:, None]
    ends, _ = roll_out(sms, q, rates[0], np.diff(rates, axis=0) / dt, dt, momentum)
    return np.array(ends[-1])


def _states(
    sms: SpaceManipulator,
    q: FloatArray,
    rates: FloatArray,
    accelerations: FloatArray,
    dt: float,
    momentum: ArrayLike | None,
    mode: str,
) -> FloatArray:
    """Return the states (12 + 2 n, N + 1) at the nodes under joint accelerations (n, N).

    Each column has the root's rotation matrix (9, by rows) and position (3), then the joint positions (n) and
    the joint rates (n).
    """
    total = np.zeros(6) if momentum is None else vector("momentum", momentum, 6)
    rotation = pin.Quaternion(q[3:7]).toRotationMatrix()
    start = np.concatenate([rotation.ravel(), q[:3], sms.layout.positions(q), rates])
    return kernel.roll_out(sms.arm_stack(mode).tree, start, accelerations, total, dt)
