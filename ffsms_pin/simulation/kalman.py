"""A Kalman filter of a position and its rate, both measured, for channels that share their noise."""

from __future__ import annotations

__all__ = ["PositionAndRate"]

_SURPRISE = 5.0  # standard deviations; noise goes beyond once in a million measurements


class PositionAndRate:
    """Covariance and gains of the state (p, r), p' = r, r' = known + white noise, with p and r measured.

    The gains depend on the noise and on time alone, so one filter serves all joints, or all axes.

    Parameters
    ----------
    position_noise, rate_noise : float
        Standard deviations of the two measurements, [x] and [x/s]; zero for a perfect one.
    acceleration_noise : float
        Square root of the spectral density of what changes the rate beside the known part [x/s^1.5].
    """

    def __init__(self, position_noise: float, rate_noise: float, acceleration_noise: float) -> None:
        self._R_p, self._R_r = position_noise**2, rate_noise**2
        self._density = acceleration_noise**2
        # The first measurement is the first estimate.
        self._pp, self._pr, self._rr = self._R_p, 0.0, self._R_r

    @property
    def deviation(self) -> tuple[float, float]:
        """Standard deviations of the present estimate of p and r."""
        return max(self._pp, 0.0) ** 0.5, max(self._rr, 0.0) ** 0.5

    def predict(self, dt: float) -> None:
        """Let `dt` [s] pass."""
        pp, pr, rr, S = self._pp, self._pr, self._rr, self._density
        self._pp = pp + 2.0 * dt * pr + dt * dt * rr + S * dt**3 / 3.0
        self._pr = pr + dt * rr + 0.5 * S * dt * dt
        self._rr = rr + S * dt

    def doubt(self, rate_error: float) -> None:
        """Trust the sensors alone where a measured rate is further from the predicted one than by noise.

        The model is wrong then by more than was counted on: a body was captured, say.

        Parameters
        ----------
        rate_error : float
            The largest difference between measured and predicted rates.
        """
        if self._R_r > 0.0 and rate_error * rate_error > _SURPRISE**2 * (self._rr + self._R_r):
            self._pp, self._pr = max(self._pp, self._R_p), 0.0
            self._rr = max(self._rr, rate_error * rate_error)

    def gains(self) -> tuple[float, float, float, float]:
        """Take in a measurement of both.

        Returns
        -------
        tuple of float
            Gains K_pp, K_pr, K_rp, K_rr: p += K_pp e_p + K_pr e_r and r += K_rp e_p + K_rr e_r, where e_p and
            e_r are the measurements less what was predicted.
        """
        pp, pr, rr, R_p, R_r = self._pp, self._pr, self._rr, self._R_p, self._R_r
        if R_p == 0.0 and R_r == 0.0:
            self._pp = self._pr = self._rr = 0.0
            return 1.0, 0.0, 0.0, 1.0
        a, c = pp + R_p, rr + R_r
        determinant = a * c - pr * pr
        if determinant <= 0.0:  # nothing is uncertain
            return 0.0, 0.0, 0.0, 0.0
        K_pp = (pp * c - pr * pr) / determinant
        K_pr = pr * R_p / determinant
        K_rp = pr * R_r / determinant
        K_rr = (rr * a - pr * pr) / determinant
        # After the update K R is the covariance: exact, symmetric, and never below zero.
        self._pp, self._pr, self._rr = K_pp * R_p, K_pr * R_r, K_rr * R_r
        return K_pp, K_pr, K_rp, K_rr
