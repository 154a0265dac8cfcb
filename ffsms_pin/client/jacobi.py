"""Jacobi's elliptic functions from the complementary modulus, and integrals of functions of dn.

SciPy's take the parameter k^2, which near 1 has lost what tells one motion from another; these take k' =
sqrt(1 - k^2). References: NIST Digital Library of Mathematical Functions (https://dlmf.nist.gov), sections
22.20(ii) (arithmetic-geometric mean) and 19.25 (Legendre's integrals by Carlson's).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.special import elliprf

from ffsms_pin.checks import FloatArray

__all__ = ["PeriodicIntegral", "amplitude_argument", "jacobi", "quarter_period"]

# Nodes of a period. The coefficients of 1 / (1 + u dn) fall at least as fast as exp(-n pi K'/K): even for
# k' = 1e-15, where K = 36, some 300 of them are above rounding.
_NODES = 1024
_ROUNDING = 1e-17
_COME_TOGETHER = 1e-9  # the means; the difference is squared with each, so the next is below rounding


def quarter_period(k1: float) -> float:
    """K, the complete integral of the first kind, of the complementary modulus `k1` in (0, 1]."""
    return float(elliprf(0.0, k1**2, 1.0))


def amplitude_argument(sine: float, cosine: float, k1: float) -> float:
    """The argument u whose sn and cn have the signs and the ratio of two numbers: F(atan2(sine, cosine))."""
    scale = np.hypot(sine, cosine)
    s, c = sine / scale, cosine / scale
    u = s * float(elliprf(c**2, c**2 + (k1 * s) ** 2, 1.0))
    return float(u if c >= 0.0 else np.copysign(2.0 * quarter_period(k1), s) - u)


def jacobi(u: FloatArray, k1: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The functions sn, cn and dn at arguments of any shape, by the arithmetic-geometric mean."""
    a, b, c = 1.0, k1, float(np.sqrt((1.0 - k1) * (1.0 + k1)))
    means = []
    while abs(c) > _COME_TOGETHER * a:
        a, b, c = 0.5 * (a + b), float(np.sqrt(a * b)), 0.5 * (a - b)
        means.append((a, c))
    # Whole periods are taken off first: the amplitude would grow with them, and lose digits.
    period = 4.0 * quarter_period(k1)
    phi = 2.0 ** len(means) * a * (u - period * np.round(u / period))
    for a, c in reversed(means):
        phi = 0.5 * (phi + np.arcsin(c / a * np.sin(phi)))
    sn, cn = np.sin(phi), np.cos(phi)
    return sn, cn, np.hypot(cn, k1 * sn)


@dataclass(frozen=True, eq=False)
class PeriodicIntegral:
    """The integral from zero of an even function of period 2 K, by its Fourier series.

    Attributes
    ----------
    mean : float
    wave_number : float
        pi / K.
    amplitudes : ndarray, shape (m,)
        Of sin(n wave_number u), n = 1..m.
    """

    mean: float
    wave_number: float
    amplitudes: FloatArray

    @classmethod
    def of(cls, function: Callable[[FloatArray], FloatArray], k1: float) -> PeriodicIntegral:
        """Of `function(dn)`, smooth and even in the argument of dn; dn of the complementary modulus `k1`."""
        K = quarter_period(k1)
        _, _, dn = jacobi(np.linspace(0.0, 2.0 * K, _NODES, endpoint=False), k1)
        series = np.fft.rfft(function(dn)).real / _NODES
        n = np.arange(1, _NODES // 2)
        amplitudes = 2.0 * K / np.pi * series[1:-1] / n
        kept = np.flatnonzero(np.abs(amplitudes) > _ROUNDING)
        last = 0 if kept.size == 0 else int(kept[-1]) + 1
        return cls(float(series[0]), np.pi / K, amplitudes[:last])

    def __call__(self, u: FloatArray) -> FloatArray:
        """The integral from 0 to each of `u` (K,)."""
        n = np.arange(1, len(self.amplitudes) + 1)
        waves: FloatArray = np.sin(self.wave_number * u[:, None] * n) @ self.amplitudes
        return self.mean * u + waves
