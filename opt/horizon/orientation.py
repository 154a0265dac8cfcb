"""The wanted attitude of the end effector, as residuals of whole motions."""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.horizon.stacks import log3, skew

__all__ = ["orientation_residual"]


def orientation_residual(
    wanted: FloatArray, attitude: FloatArray, turn: FloatArray, tolerance: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rotation vectors to the wanted attitude, less a tolerance in length, and their slopes.

    Parameters
    ----------
    wanted : ndarray, shape (3, 3)
    attitude : ndarray, shape (S, K, 3, 3)
        Of the end effector, in the same axes.
    turn : ndarray, shape (S, K, 3, P)
        How these turn with the parameters, in the same axes.
    tolerance : float
        [rad]

    Returns
    -------
    value : ndarray, shape (S, 3 K)
        [rad]
    slope : ndarray, shape (S, 3 K, P)
    angle : ndarray, shape (S, K)
        To the wanted attitude, without the tolerance [rad].
    """
    e = log3(wanted @ np.swapaxes(attitude, -1, -2))
    angle = np.linalg.norm(e, axis=-1)
    # d log(X exp(-delta)) = -J_r^-1(e) delta. Reference: J. Sola et al., "A micro Lie theory", 2018, eq. 144.
    safe = np.clip(angle, 1e-4, np.pi - 1e-3)
    factor = 1.0 / safe**2 - (1.0 + np.cos(safe)) / (2.0 * safe * np.sin(safe))
    E = skew(e)
    inverse = np.eye(3) + 0.5 * E + factor[..., None, None] * (E @ E)
    # Shortened by the tolerance: what is left of e, and the slope of the shortening.
    unit = e / np.maximum(angle, 1e-12)[..., None]
    left = np.maximum(angle - tolerance, 0.0)
    share = (left / np.maximum(angle, 1e-12))[..., None, None]
    radial = unit[..., :, None] * unit[..., None, :]
    shorten = share * np.eye(3) + (np.where(left > 0.0, 1.0, 0.0)[..., None, None] - share) * radial
    slope = -(shorten @ inverse) @ turn
    stacked = slope.reshape(len(slope), -1, slope.shape[-1])
    return (left[..., None] * unit).reshape(len(e), -1), stacked, angle
