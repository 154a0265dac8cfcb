"""Motion of a rigid body without torque, in closed form, at any time.

In principal axes the unit vector m along the angular momentum h goes round the axis z of the least or the
greatest inertia, on which side the energy decides (Poinsot). With a = 1 / inertia and M = |h|,

    m = (X cn u, Y sn u, Z dn u),     u = u0 + M lambda t,     Z > 0.

The attitude is C R_z(psi) A(m): A is the least turn that brings m to z, C is constant. A is smooth, because
m never comes near -z. With A chosen so, the phase follows from omega . (m + z) = (1 + m_z) dpsi/dt:

    psi = M a_z t + M (e - a_z) int dt / (1 + Z dn u),     e = 2 (energy) / M^2.

The integrand is smooth and periodic, so its Fourier series gives the integral to rounding.

Errors: rounding, some 1e-16 times the angle that the body has turned by, except where the motion itself
magnifies it: after a fall away from the intermediate axis.

References: L. D. Landau, E. M. Lifshitz, "Mechanics", section 37 (m); the phase in these axes is our own
derivation, beside R. van Zon, J. Schofield, "Numerical implementation of the exact dynamics of free rigid
bodies", Journal of Computational Physics 225 (2007), who take Euler's angles.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.client.jacobi import PeriodicIntegral, amplitude_argument, jacobi

__all__ = ["Rotation", "SteadySpin", "TumblingSpin", "torque_free"]

# A rate of change of m, against the rate of the spin, that no float64 tells from none.
_STEADY = 4.0 * float(np.finfo(np.float64).eps)
# Nearer to the separatrix than this, a motion cannot be told from one beside it.
_LEAST_K1 = 1e-15


class Rotation(Protocol):
    """How a body turns: attitudes (K, 3, 3) at times (K,) [s] since the start, body axes to inertial axes."""

    def __call__(self, t: FloatArray) -> FloatArray:
        """Attitudes at times."""


@dataclass(frozen=True, eq=False)
class SteadySpin:
    """A constant angular velocity: about a principal axis, of a body with equal inertias, or none.

    Attributes
    ----------
    attitude : ndarray, shape (3, 3)
        At the start.
    spin : ndarray, shape (3,)
        Angular velocity, inertial axes [rad/s].
    """

    attitude: FloatArray
    spin: FloatArray

    def __call__(self, t: FloatArray) -> FloatArray:
        """Attitudes (K, 3, 3) at times (K,) [s]."""
        rate = float(np.linalg.norm(self.spin))
        axis = self.spin / rate if rate else np.array([0.0, 0.0, 1.0])
        x, y, z = axis
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        angle = (rate * t)[:, None, None]
        turns = np.eye(3) + np.sin(angle) * cross + 2.0 * np.sin(0.5 * angle) ** 2 * (cross @ cross)
        return np.asarray(turns @ self.attitude)


@dataclass(frozen=True, eq=False)
class TumblingSpin:
    """The general case; see the module.

    Attributes
    ----------
    axes : ndarray, shape (3, 3)
        The principal axes x, y, z as columns, body axes; m goes round z, and m_z is above zero.
    start : ndarray, shape (3, 3)
        C, with A(m) at the start taken up in it.
    amplitudes : ndarray, shape (3,)
        X, Y, Z.
    k1 : float
        Complementary modulus.
    u0, rate : float
        u at the start, and M lambda [1/s].
    steady, extra : float
        M a_z and (e - a_z) / lambda: factors of the time and of the integral in the phase [rad/s, rad].
    integral : PeriodicIntegral
        Of 1 / (1 + Z dn).
    """

    axes: FloatArray
    start: FloatArray
    amplitudes: FloatArray
    k1: float
    u0: float
    rate: float
    steady: float
    extra: float
    integral: PeriodicIntegral

    def __call__(self, t: FloatArray) -> FloatArray:
        """Attitudes (K, 3, 3) at times (K,) [s]."""
        u = self.u0 + self.rate * t
        x, y, z = self.amplitudes[:, None] * _round(u, self.k1)
        psi = self.steady * t + self.extra * (self.integral(u) - self.integral(np.array([self.u0])))
        return self.start @ _about_z(psi) @ _least_turn(x, y, z) @ self.axes.T


def torque_free(inertia: FloatArray, attitude: FloatArray, spin: FloatArray) -> Rotation:
    """The rotation of a body.

    Parameters
    ----------
    inertia : ndarray, shape (3, 3)
        About the centre of mass, body axes [kg m^2]; positive definite.
    attitude : ndarray, shape (3, 3)
        At the start.
    spin : ndarray, shape (3,)
        Angular velocity at the start, inertial axes [rad/s].
    """
    moments, principal = np.linalg.eigh(inertia)
    if np.linalg.det(principal) < 0.0:
        principal[:, 2] *= -1.0
    h = moments * (principal.T @ attitude.T @ spin)
    M = float(np.linalg.norm(h))
    a = 1.0 / moments
    m = h / M if M > 0.0 else h
    if np.abs(np.cross(m, a * m)).max() <= _STEADY * a.max():
        return SteadySpin(attitude, spin)

    # Round which axis: the sign of 2 (energy) / M^2 - 1 / (the middle inertia).
    low, high = (moments[1] - moments[0]) * a[0] * a[1], (moments[2] - moments[1]) * a[1] * a[2]
    if low * m[0] ** 2 - high * m[2] ** 2 <= 0.0:
        axes = principal
        x_y, y_z, sign = low, high, 1.0
    else:
        axes, m, a = principal[:, ::-1] * [1.0, -1.0, 1.0], m[::-1] * [1.0, -1.0, 1.0], a[::-1]
        x_y, y_z, sign = high, low, -1.0
    if m[2] < 0.0:
        axes, m = axes * [1.0, -1.0, -1.0], m * [1.0, -1.0, -1.0]

    # Differences of a without signs: x_y between x and y, y_z between y and z.
    x_z = x_y + y_z
    X, Z = np.hypot(m[0], m[1] * np.sqrt(y_z / x_z)), np.hypot(m[2], m[1] * np.sqrt(x_y / x_z))
    Y = X * np.sqrt(x_z / y_z)
    k1 = np.sqrt(max(m[2] ** 2 * y_z - m[0] ** 2 * x_y, 0.0) / y_z) / Z
    k1 = float(min(max(k1, _LEAST_K1), 1.0))
    u0 = amplitude_argument(m[1] * np.sqrt(y_z), m[0] * np.sqrt(x_z), k1)
    rate = sign * Z * np.sqrt(x_z * y_z)
    amplitudes = np.array([X, Y, Z])
    e_less_a = sign * (x_z * m[0] ** 2 + y_z * m[1] ** 2)
    now = amplitudes[:, None] * _round(np.array([u0]), k1)
    return TumblingSpin(
        axes=axes,
        start=attitude @ axes @ _least_turn(*now)[0].T,
        amplitudes=amplitudes,
        k1=k1,
        u0=u0,
        rate=M * rate,
        steady=M * a[2],
        extra=e_less_a / rate,
        integral=PeriodicIntegral.of(lambda dn: 1.0 / (1.0 + Z * dn), k1),
    )


def _round(u: FloatArray, k1: float) -> FloatArray:
    """Rows cn, sn, dn."""
    sn, cn, dn = jacobi(u, k1)
    return np.stack([cn, sn, dn])


def _about_z(angle: FloatArray) -> FloatArray:
    """Rotations (K, 3, 3)."""
    turns = np.zeros((len(angle), 3, 3))
    turns[:, 0, 0] = turns[:, 1, 1] = np.cos(angle)
    turns[:, 1, 0] = np.sin(angle)
    turns[:, 0, 1] = -turns[:, 1, 0]
    turns[:, 2, 2] = 1.0
    return turns


def _least_turn(x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
    """Rotations (K, 3, 3) that bring unit vectors with components (K,), z > -1, to the axis z."""
    share = 1.0 / (1.0 + z)
    rows = [[1.0 - x * x * share, -x * y * share, -x], [-x * y * share, 1.0 - y * y * share, -y], [x, y, z]]
    turns: FloatArray = np.moveaxis(np.array(rows), -1, 0)
    return turns
