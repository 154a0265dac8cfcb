"""A law that brings all joints to rest and dissipates energy for any masses of the plant."""

from __future__ import annotations

import math

import daqp
import numpy as np
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray, instance, one_each, positive
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system import dynamics
from ffsms_pin.system.dynamics import floating_motion

_TIME = 0.5  # [s] default time constant of braking
_CORRECTION = 0.02  # [s] time constant of the correction by measured rates; delays of drives must be shorter
_SHARE = 0.5  # least dissipated power, as a share of the power of braking without the correction
_RESERVE = 1e-3  # [rad or m] safety margin before a stop
STEPS = 4.0  # control steps in the shortest time constant of braking


class StoppingLaw:
    """A joint torque law that brakes all joints within their torque limits; each braking needs a new law.

    Without limits the torque is tau* = -k H_q qd, with the reduced inertia matrix H_q. Apart from Coriolis
    and centrifugal effects, all joints then decelerate at the same rate, qdd = -k qd. With limits the torque
    is the nearest to tau* within the limits, in the metric of H_q^-1. The rate k is 1 / `time`, or larger if
    a joint would otherwise reach its stop, but at most 1 / (4 dt).

    Limp joints have no torque. For the other joints, the Schur complement of H_q replaces H_q, because limp
    joints move passively.

    With wrong masses, such as an unknown payload, this torque alone would accelerate light joints while the
    others slow down. So the integral of H_q (-k qd - qdd) / 0.02 s is added to tau*, with the measured rates
    qd and accelerations qdd.

    The torque dissipates energy for any masses, because of a constraint on its power. Let tau_s be tau*
    without the correction, scaled down into the limits. The power qd^T tau_s is negative, because H_q is
    positive definite. The power qd^T tau must be at most half of qd^T tau_s. tau_s satisfies all constraints,
    so the problem is feasible.

    Parameters
    ----------
    sms : SpaceManipulator
    dt : float
        Control step [s].
    torque_limit : array_like
        Largest magnitude of each torque [N m], one number or (n,), infinite for no limit.
    time : float
        Time constant of braking [s].
    """

    def __init__(
        self, sms: SpaceManipulator, dt: float, torque_limit: object = np.inf, time: float = _TIME
    ) -> None:
        instance("sms", sms, SpaceManipulator)
        self.sms = sms
        self.torque_limit = one_each("torque_limit", torque_limit, sms.n, "N m", largest=np.inf)
        self._slowest, self._fastest = (
            1.0 / positive("time", time, "s"),
            1.0 / (STEPS * positive("dt", dt, "s")),
        )
        self._dt, self._gain = dt, -math.expm1(-dt / _CORRECTION)
        self._last: tuple[FloatArray, FloatArray] | None = None  # rates and correction of the last step

    def torque(self, q: FloatArray, v: FloatArray, limp: NDArray[np.bool_] | None = None) -> FloatArray:
        """Return the joint torques (n,) [N m] at a measured state, zero for the joints of the mask `limp`."""
        driven = np.ones(self.sms.n, dtype=bool) if limp is None else ~limp
        M = dynamics.inertia_matrix(self.sms, q)
        H, rates, most = M[6:] @ floating_motion(M), v[6:][driven], self.torque_limit[driven]
        if not driven.all():  # limp joints move passively with the others
            along = np.linalg.solve(H[~driven][:, ~driven], H[~driven][:, driven])
            H = H[driven][:, driven] - H[driven][:, ~driven] @ along
        k = self._rate(q, np.where(driven, v[6:], 0.0))
        braking = -k * (H @ rates)
        desired = braking + self._correction(H, k, rates)
        safe = _scaled(braking, most)
        power = _SHARE * float(rates @ safe)
        torque = desired
        if np.isfinite(desired).all() and ((np.abs(desired) > most).any() or rates @ desired > power):
            nearest = _nearest(H, desired, most, rates, power)
            torque = safe if nearest is None else nearest
        self._last = rates.copy(), torque - braking
        whole = np.zeros(self.sms.n)
        whole[driven] = torque
        return whole

    def _correction(self, H: FloatArray, k: float, rates: FloatArray) -> FloatArray:
        """Return the torques of the driven joints that compensate wrong masses in the model."""
        if self._last is None or self._last[0].shape != rates.shape:  # first call, or a new limp joint
            return np.zeros_like(rates)
        before, correction = self._last
        missing = -k * 0.5 * (rates + before) - (rates - before) / self._dt
        return correction + self._gain * (H @ missing)

    def _rate(self, q: FloatArray, rates: FloatArray) -> float:
        """Return the rate k [1/s], larger than 1 / `time` if a joint would otherwise reach its stop."""
        limits, joints = self.sms.limits, self.sms.layout.positions(q)
        slack = np.where(rates > 0.0, limits.upper - joints, joints - limits.lower)
        needed = np.abs(rates) / np.maximum(slack - _RESERVE, 1e-6)
        slowest = min(self._slowest, self._fastest)
        return float(np.clip(needed.max(initial=0.0), slowest, self._fastest))


def _scaled(torque: FloatArray, most: FloatArray) -> FloatArray:
    """Return the torques (n,) scaled down by one factor to within +-most (n,)."""
    return torque * float(np.min(most / np.maximum(np.abs(torque), 1e-300), initial=1.0))


def _nearest(
    H: FloatArray, desired: FloatArray, most: FloatArray, rates: FloatArray, power: float
) -> FloatArray | None:
    """Return the torques within +-most (n,) that are nearest to `desired` (n,) in the metric of H^-1.

    Their power at `rates` (n,) is at most `power` [W]. Return None if the solver fails.
    """
    bound = np.flatnonzero(np.isfinite(most))
    try:
        L = np.linalg.cholesky(H)
    except np.linalg.LinAlgError:
        return None
    size = float(np.linalg.norm(np.linalg.solve(L, desired)))
    # With tau = desired + size L z, |z| is minimised; each row is divided by the limit of its joint.
    unit = np.maximum(most[bound], 1e-9 * np.abs(desired).max())
    rows, at, bounds = size * L[bound] / unit[:, None], desired[bound] / unit, most[bound] / unit
    scale = max(float(np.abs(rates) @ np.abs(desired)), 1e-300)
    rows = np.vstack([rows, size * (rates @ L) / scale])
    upper, lower = np.append(bounds - at, (power - rates @ desired) / scale), np.append(-bounds - at, -np.inf)
    # DAQP's code 5 is an equality constraint, for a joint with a limit of zero.
    sense = np.where(np.append(bounds, 1.0) > 0.0, 0, 5).astype(np.int32)
    z, _, status, _ = daqp.solve(None, np.zeros(len(L)), rows, upper, lower, sense)
    if status != 1 or not np.isfinite(z).all():
        return None
    return np.asarray(np.clip(desired + size * (L @ z), -most, most))
