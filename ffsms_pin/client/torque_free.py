"""The torque-free motion of a rigid body, in closed form.

In principal axes the unit vector m along the angular momentum h moves round the axis z. Depending on the
energy, z is the axis of the least or the greatest inertia (Poinsot). Let a be the inverses of the principal
inertias and M = |h|. With Jacobi's elliptic functions cn, sn, dn of modulus k, and constants X, Y, Z and
lambda,

    m = (X cn u, Y sn u, Z dn u),     u = u0 + M lambda t,     Z > 0.

The attitude of the principal axes is C R_z(psi) A(m), where A is the smallest rotation of m to z and C is
constant. A is smooth, because m never comes near -z. The phase psi follows from
omega . (m + z) = (1 + m_z) dpsi/dt:

    psi = M a_z t + M (e - a_z) int dt / (1 + Z dn u),     e = 2 (energy) / M^2.

The integrand is smooth and periodic, so its Fourier series gives the integral to rounding. SciPy's elliptic
functions take the parameter k^2, which loses precision near k^2 = 1. Therefore the functions below take the
complementary modulus k' = sqrt(1 - k^2).

Errors are typically below 1e-15 times the angle of rotation, except near the unstable intermediate axis,
where they grow because the motion is unstable.

References: L. D. Landau, E. M. Lifshitz, "Mechanics", section 37, for m. The phase is derived here; R. van
Zon, J. Schofield, "Numerical implementation of the exact dynamics of free rigid bodies", Journal of
Computational Physics 225 (2007), derive it with Euler's angles. NIST Digital Library of Mathematical
Functions, 22.20(ii) for the arithmetic-geometric mean, 19.25 for Legendre's integrals by Carlson's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TypeAlias

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.system.batch.stacks import exp3

# Threshold below which a value is a rounding error: the rate of m relative to the spin rate, or k' (zero on
# the separatrix).
_NONE = 4.0 * float(np.finfo(np.float64).eps)
# Nodes in a period of the integrand 1 / (1 + Z dn). Its Fourier coefficients fall at least as fast as
# exp(-n pi K'/K). Even for k' = 1e-15, where K = 36, only some 300 of them are above rounding.
_NODES = 1024
_ROUNDING = 1e-17

# A function from times (K,) [s] since the start to attitudes (K, 3, 3), body axes to inertial axes.
Rotation: TypeAlias = Callable[[FloatArray], FloatArray]


def _steady(attitude: FloatArray, spin: FloatArray, t: FloatArray) -> FloatArray:
    """Return attitudes (K, 3, 3) at times (K,) [s] for a constant angular velocity, possibly zero."""
    return np.moveaxis(exp3(spin[:, None] * t), -1, 0) @ attitude


@dataclass(frozen=True, eq=False)
class TumblingSpin:
    """The attitude of a tumbling body over time, with the symbols of the module's docstring."""

    axes: FloatArray  # principal axes x, y, z as columns, in body axes; m moves round z, and m_z > 0
    start: FloatArray  # C = R axes A(m)^T at the start, with the attitude R
    amplitudes: FloatArray  # X, Y, Z
    k1: float  # the complementary modulus k'
    u0: float  # u at the start
    rate: float  # M lambda [1/s]
    steady: float  # M a_z, the factor of the time in the phase [rad/s]
    extra: float  # (e - a_z) / lambda, the factor of the integral in the phase [rad]
    integral: PeriodicIntegral  # the integral of 1 / (1 + Z dn)

    def __call__(self, t: FloatArray) -> FloatArray:
        """Return the attitudes (K, 3, 3) at times (K,) [s]."""
        u = self.u0 + self.rate * t
        x, y, z = self.amplitudes[:, None] * jacobi(u, self.k1)
        psi = self.steady * t + self.extra * (self.integral(u) - self.integral(np.array([self.u0])))
        return self.start @ _about_z(psi) @ _least_turn(x, y, z) @ self.axes.T


def torque_free(inertia: FloatArray, attitude: FloatArray, spin: FloatArray) -> Rotation:
    """Return the attitude of a free body as a function of the time since the start.

    The body has the inertia (3, 3) [kg m^2] in body axes. At the start it has the attitude (3, 3) and the
    angular velocity `spin` (3,) [rad/s], inertial axes.
    """
    moments, principal = np.linalg.eigh(inertia)
    if np.linalg.det(principal) < 0.0:
        principal[:, 2] *= -1.0
    h = moments * (principal.T @ attitude.T @ spin)
    M = float(np.linalg.norm(h))
    a = 1.0 / moments
    m = h / M if M > 0.0 else h
    if np.abs(np.cross(m, a * m)).max() <= _NONE * a.max():
        return partial(_steady, attitude, spin)

    # z has the least inertia if 2 (energy) / M^2 > 1 / (the middle inertia), else the greatest inertia.
    low, high = (moments[1] - moments[0]) * a[0] * a[1], (moments[2] - moments[1]) * a[1] * a[2]
    if low * m[0] ** 2 - high * m[2] ** 2 <= 0.0:
        axes = principal
        x_y, y_z, sign = low, high, 1.0
    else:
        axes, m, a = principal[:, ::-1] * [1.0, -1.0, 1.0], m[::-1] * [1.0, -1.0, 1.0], a[::-1]
        x_y, y_z, sign = high, low, -1.0
    if m[2] < 0.0:
        axes, m = axes * [1.0, -1.0, -1.0], m * [1.0, -1.0, -1.0]

    # Here x_y, y_z and x_z are the absolute differences of the inverse inertias a.
    x_z = x_y + y_z
    X, Z = np.hypot(m[0], m[1] * np.sqrt(y_z / x_z)), np.hypot(m[2], m[1] * np.sqrt(x_y / x_z))
    Y = X * np.sqrt(x_z / y_z)
    k1 = np.sqrt(max(m[2] ** 2 * y_z - m[0] ** 2 * x_y, 0.0) / y_z) / Z
    k1 = float(min(max(k1, _NONE), 1.0))
    u0 = amplitude_argument(m[1] * np.sqrt(y_z), m[0] * np.sqrt(x_z), k1)
    rate = sign * Z * np.sqrt(x_z * y_z)
    amplitudes = np.array([X, Y, Z])
    e_less_a = sign * (x_z * m[0] ** 2 + y_z * m[1] ** 2)
    now = amplitudes[:, None] * jacobi(np.array([u0]), k1)
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


def _about_z(angle: FloatArray) -> FloatArray:
    """Return rotations (K, 3, 3) about z."""
    turns = np.zeros((len(angle), 3, 3))
    turns[:, 0, 0] = turns[:, 1, 1] = np.cos(angle)
    turns[:, 1, 0] = np.sin(angle)
    turns[:, 0, 1] = -turns[:, 1, 0]
    turns[:, 2, 2] = 1.0
    return turns


def _least_turn(x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
    """Return the smallest rotations (K, 3, 3) of unit vectors to the axis z.

    The vectors have the components x, y, z (K,), with z > -1.
    """
    share = 1.0 / (1.0 + z)
    rows = [[1.0 - x * x * share, -x * y * share, -x], [-x * y * share, 1.0 - y * y * share, -y], [x, y, z]]
    turns: FloatArray = np.moveaxis(np.array(rows), -1, 0)
    return turns


def quarter_period(k1: float) -> float:
    """Return K, the complete elliptic integral of the first kind, for the complementary modulus `k1`.

    `k1` is in (0, 1].
    """
    from scipy.special import elliprf  # slow to load

    return float(elliprf(0.0, k1**2, 1.0))


def amplitude_argument(sine: float, cosine: float, k1: float) -> float:
    """Return the argument u for which (sn u, cn u) is a positive multiple of (`sine`, `cosine`)."""
    from scipy.special import elliprf

    scale = np.hypot(sine, cosine)
    s, c = sine / scale, cosine / scale
    u = s * float(elliprf(c**2, c**2 + (k1 * s) ** 2, 1.0))
    return float(u if c >= 0.0 else np.copysign(2.0 * quarter_period(k1), s) - u)


def jacobi(u: FloatArray, k1: float) -> FloatArray:
    """Return cn, sn and dn (3, ...) at arguments u (...), by the arithmetic-geometric mean."""
    a, b, c = 1.0, k1, float(np.sqrt((1.0 - k1) * (1.0 + k1)))
    means = []
    while abs(c) > np.sqrt(np.finfo(np.float64).eps) * a:  # each step about squares c / a
        a, b, c = 0.5 * (a + b), float(np.sqrt(a * b)), 0.5 * (a - b)
        means.append((a, c))
    # Whole periods are subtracted, because the amplitude would otherwise grow with u and lose digits.
    period = 4.0 * quarter_period(k1)
    phi = 2.0 ** len(means) * a * (u - period * np.round(u / period))
    for a, c in reversed(means):
        phi = 0.5 * (phi + np.arcsin(c / a * np.sin(phi)))
    sn, cn = np.sin(phi), np.cos(phi)
    return np.stack([cn, sn, np.hypot(cn, k1 * sn)])


@dataclass(frozen=True, eq=False)
class PeriodicIntegral:
    """The integral from zero of an even function of period 2 K, by its Fourier series."""

    mean: float
    wave_number: float  # pi / K
    amplitudes: FloatArray  # the amplitudes of sin(n wave_number u), n = 1..m

    @classmethod
    def of(cls, function: Callable[[FloatArray], FloatArray], k1: float) -> PeriodicIntegral:
        """Make the integral of `function(dn u)` over u, where dn has the complementary modulus `k1`."""
        K = quarter_period(k1)
        _, _, dn = jacobi(np.linspace(0.0, 2.0 * K, _NODES, endpoint=False), k1)
        series = np.fft.rfft(function(dn)).real / _NODES
        n = np.arange(1, _NODES // 2)
        amplitudes = 2.0 * K / np.pi * series[1:-1] / n
        kept = np.flatnonzero(np.abs(amplitudes) > _ROUNDING)
        last = 0 if kept.size == 0 else int(kept[-1]) + 1
        return cls(float(series[0]), np.pi / K, amplitudes[:last])

    def __call__(self, u: FloatArray) -> FloatArray:
        """Return the integrals (K,) from 0 to `u` (K,)."""
        n = np.arange(1, len(self.amplitudes) + 1)
        waves: FloatArray = np.sin(self.wave_number * u[:, None] * n) @ self.amplitudes
        return self.mean * u + waves
