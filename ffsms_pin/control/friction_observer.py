"""An estimate of the joints' Coulomb friction while a law moves them."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.system import SpaceManipulator, dynamics

# The estimate stays within this share of a joint's torque: bearings and gears take some per cent.
_SHARE = 0.25
_SLOW = 0.01  # [rad/s] at which friction turns round, as `simulation.JointFriction` has it
_SMOOTHING, _WINDOW = 0.05, 1.0  # [s] of what is measured, and of the averages that are compared
# Shares of the torque's variance that friction explains: from the first on the estimate counts, from the
# second on in full. An unknown payload takes torque that goes with accelerations, not with rates: pushing
# along with it would drive the arm into oscillations.
_EXPLAINED = 0.5, 0.8


class FrictionObserver:
    """Estimate of Coulomb friction by regression of the missing torque on the direction of motion.

    Over a control step the measured rates change by dt qdd. The model needs tau_m = H_q qdd + C_q for that at
    the middle of the step; what acted was tau. The missing torque w = tau - tau_m is compared with the side
    s = tanh(qd / 0.01 rad/s) of each joint over the last second: F = mean(w s) / mean(s^2), at least zero. It
    counts as far as it explains w, by the squared correlation mean(w s)^2 / (mean(w^2) mean(s^2)).

    Parameters
    ----------
    sms : SpaceManipulator
    dt : float
        Control step [s].
    limit : ndarray, shape (n,)
        Largest joint torques [N m], infinite for none.
    """

    def __init__(self, sms: SpaceManipulator, dt: float, limit: FloatArray) -> None:
        self._sms, self._dt, self._most = sms, dt, _SHARE * limit
        self._quick, self._slow = -math.expm1(-dt / _SMOOTHING), -math.expm1(-dt / _WINDOW)
        self._smooth = np.zeros((2, sms.n))  # w and s
        self._means = np.zeros((3, sms.n))  # of w s, s^2 and w^2
        self._last: tuple[FloatArray, FloatArray, FloatArray] | None = None

    @property
    def friction(self) -> FloatArray:
        """The estimate F (n,) [N m], as far as it counts."""
        both, side, missing = self._means
        product = np.maximum(missing * side, 1e-300)
        least, most = _EXPLAINED
        share = np.clip((both**2 / product - least) / (most - least), 0.0, 1.0)
        found: FloatArray = share * np.clip(both / np.maximum(side, 1e-12), 0.0, self._most)
        return found

    def update(self, q: FloatArray, v: FloatArray) -> None:
        """Take in a measured state."""
        if self._last is None:
            return
        q0, v0, tau = self._last
        mean = 0.5 * (v0 + v)
        middle = pin.integrate(self._sms.model, q0, 0.5 * self._dt * mean)
        needed = dynamics.floating_torque(self._sms, middle, mean, (v[6:] - v0[6:]) / self._dt)
        self._smooth += self._quick * (np.stack([tau - needed, np.tanh(mean[6:] / _SLOW)]) - self._smooth)
        w, s = self._smooth
        self._means += self._slow * (np.stack([w * s, s * s, w * w]) - self._means)

    def torque(self, commanded: FloatArray) -> FloatArray:
        """Return what makes friction good at commanded joint rates (n,): torques (n,) [N m]."""
        return self.friction * np.tanh(commanded / _SLOW)

    def acted(self, q: FloatArray, v: FloatArray, tau: FloatArray) -> None:
        """Remember the state and the torque of a step that begins."""
        self._last = q.copy(), v.copy(), tau
