"""The noise of the measurements, for the weights and the bias correction of the regression."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.lib.stride_tricks import sliding_window_view

from ffsms_pin.checks import FloatArray
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation import Sensors

# [m/s, rad/s] default deviation if the sensors are unknown; the residuals scale it.
NOMINAL = 1e-6
_ORDERS = (3, 5, 7)  # orders of the differences that estimate noise
_LEAST = 1e-9  # [m/s, rad/s] least deviation in the weights, so that they stay finite
# Assumed joint rates, as a share of their limits, for the effect of joint position noise. A limit of 10 rad/s
# or more is replaced by 1 rad/s.
_USUAL_SHARE = 0.3


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """The noise of the measurements.

    Attributes
    ----------
    rates : ndarray, shape (6 + n,)
        The variances of the velocity in Pinocchio's layout [m^2/s^2, rad^2/s^2], for weights.
    biasing : ndarray, shape (6 + n,)
        The same variances without assumed lower bounds, for the bias correction of the regression.
    position, attitude : float
        The variances of the base's pose, per axis [m^2, rad^2].
    latency : float
        The latency of the base's pose and velocity [s].
    stated : bool
        True if the noise is that of given sensors.
    """

    rates: FloatArray
    biasing: FloatArray
    position: float
    attitude: float
    latency: float
    stated: bool

    @classmethod
    def of(cls, sms: SpaceManipulator, sensors: Sensors | None) -> NoiseModel:
        """Return the noise of `sensors`; all velocities have one small deviation if it is None or perfect."""
        if sensors is None or sensors.perfect:
            return cls(np.full(sms.nv, NOMINAL**2), np.zeros(sms.nv), 0.0, 0.0, 0.0, False)
        limits = sms.limits.velocity
        usual = _USUAL_SHARE * np.where(np.isfinite(limits) & (limits < 10.0), limits, 1.0)
        joints = np.hypot(sensors.joint_rate_noise, sensors.joint_deviation * usual)
        deviations = np.concatenate(
            [np.repeat([sensors.base_velocity_noise, sensors.base_rate_noise], 3), joints]
        )
        return cls(
            np.maximum(deviations, _LEAST) ** 2,
            deviations**2,
            sensors.base_position_noise**2,
            sensors.base_attitude_noise**2,
            sensors.base_latency,
            True,
        )

    @classmethod
    def shown_by(cls, t: FloatArray, v: FloatArray) -> NoiseModel:
        """Return the noise of velocities v (N, 6 + n) at t (N,), estimated from their differences."""
        noise = np.nan_to_num(noise_of(t, v))
        return cls(np.maximum(noise, NOMINAL) ** 2, noise**2, 0.0, 0.0, 0.0, False)

    def of_pose(self, momentum: FloatArray) -> FloatArray:
        """Return the covariance (6, 6) of a total momentum (6,) due to the noise of the base's pose."""
        shift, turn = np.zeros((6, 3)), np.zeros((6, 3))
        shift[3:] = turn[:3] = pin.skew(momentum[:3])
        turn[3:] = pin.skew(momentum[3:])
        return np.asarray(self.position * shift @ shift.T + self.attitude * turn @ turn.T)


def noise_of(t: FloatArray, values: FloatArray) -> FloatArray:
    """Return the standard deviations (k,) of the noise in series (N, k), from divided differences.

    The least of the estimates by several orders is returned, because differences of low order also contain
    the motion if the sampling rate is low. Series of fewer than 14 samples give zero.
    """
    if len(values) < 2 * max(_ORDERS):
        return np.zeros(values.shape[1])
    squares = []
    for order in _ORDERS:
        times = sliding_window_view(t / float(np.median(np.diff(t))), order + 1)
        gaps = times[:, :, None] - times[:, None, :] + np.eye(order + 1)
        shares = 1.0 / gaps.prod(axis=2)
        shares /= np.linalg.norm(shares, axis=1)[:, None]
        differences = np.einsum("ik,ick->ic", shares, sliding_window_view(values, order + 1, axis=0))
        squares.append(np.mean(differences**2, axis=0))
    return np.asarray(np.sqrt(np.min(squares, axis=0)))
