"""The wanted attitude of the end effector, as residuals of whole motions."""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.system.batch.stacks import apply, dot, log3, skew

__all__ = ["orientation_residual"]


def orientation_residual(
    wanted: FloatArray, attitude: FloatArray, tolerance: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rotation vectors to the wanted attitude, less a tolerance in length, and their slopes.

    Parameters
    ----------
    wanted : ndarray, shape (3, 3, ...)
    attitude : ndarray, shape (3, 3, ...)
        Of the end effector, in the same axes.
    tolerance : float
        [rad]

    Returns
    -------
    value : ndarray, shape (3, ...)
        [rad]
    by_turn : ndarray, shape (3, 3, ...)
        Its slopes by a turn of the end effector, in the same axes; value first.
    angle : ndarray, shape (...)
        To the wanted attitude, without the tolerance [rad].
    """
    e = log3(np.einsum("xy...,zy...->xz...", wanted, attitude))
    angle = np.sqrt(dot(e, e))
    # d log(X exp(-delta)) = -J_r^-1(e) delta. Reference: J. Sola et al., "A micro Lie theory", 2018, eq. 144.
    safe = np.clip(angle, 1e-4, np.pi - 1e-3)
    factor = 1.0 / safe**2 - (1.0 + np.cos(safe)) / (2.0 * safe * np.sin(safe))
    eye = np.eye(3).reshape(3, 3, *(1,) * angle.ndim)
    E = skew(e)
    inverse = eye + 0.5 * E + factor * apply(E, E)
    # Shortened by the tolerance: what is left of e, and the slope of the shortening.
    unit = e / np.maximum(angle, 1e-12)
    left = np.maximum(angle - tolerance, 0.0)
    share = left / np.maximum(angle, 1e-12)
    shorten = share * eye + (np.where(left > 0.0, 1.0, 0.0) - share) * (unit[:, None] * unit)
    return left * unit, -apply(shorten, inverse), angle
