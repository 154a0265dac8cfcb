"""The estimation of the joints' Coulomb friction during a controlled motion."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.actuation.wheels import SLOW
from ffsms_pin.checks import FloatArray
from ffsms_pin.control.step_observer import StepObserver
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system import dynamics

# Upper bound of the estimate, as a share of a joint's torque limit; friction is usually a few per cent.
_SHARE = 0.25
_SMOOTHING, _WINDOW = 0.05, 1.0  # [s] time constants of the smoothed measurements and of their averages
# Squared partial correlations: below the first the estimate is not used, above the second it is used in full.
_EXPLAINED = 0.5, 0.8
# Measured share of the window below which the estimate is reduced, because any model fits few samples.
_ENOUGH = 0.2


class FrictionObserver(StepObserver):
    """An estimator of Coulomb friction by regression of the missing torque on the direction of motion.

    Over a control step the measured rates change by dt qdd. For a floating base, the model's torque for this
    change is tau_m = H_q qdd + C_q, at the middle of the step. For a robot with wheels or thrusters, tau_m is
    the joint torque for qdd and the measured acceleration of the base, for any force on the base. Let tau be
    the applied torque, and tau_k the known friction (negative for positive rates). The missing torque of each
    joint is w = tau + tau_k - tau_m. It is fitted by F s + I qdd with a forgetting time of 1 s, where s =
    tanh(qd / 0.01 rad/s), and F is between zero and a quarter of the joint's torque limit. I absorbs the
    effect of a wrong inertia, such as that of an unknown payload; a law that compensated this effect as
    friction would make the arm oscillate. F is weighted by a factor from 0 to 1, which rises as the squared
    partial correlation of w and s, given qdd, rises from 0.5 to 0.8. In the first 0.2 s of a run, the factor
    is lower.

    Parameters
    ----------
    sms : SpaceManipulator
    dt : float
        Control step [s].
    limit : ndarray, shape (n,)
        Largest joint torques [N m], infinite for no limit.
    viscous, coulomb : array_like
        The known friction [N m s/rad], [N m], which the law compensates; F is additional friction.
    """

    def __init__(
        self,
        sms: SpaceManipulator,
        dt: float,
        limit: FloatArray,
        viscous: ArrayLike = 0.0,
        coulomb: ArrayLike = 0.0,
    ) -> None:
        super().__init__(sms, dt, viscous, coulomb)
        self._most = _SHARE * limit
        self._driven = sms.wheels is not None or sms.thrusters is not None
        self._quick, self._slow = -math.expm1(-dt / _SMOOTHING), -math.expm1(-dt / _WINDOW)
        self._smooth = np.zeros((3, sms.n))  # w, s and qdd
        self._means = np.zeros((3, 3, sms.n))  # averages of the products of w, s and qdd
        self._filled = 0.0  # measured share of the window

    @property
    def friction(self) -> FloatArray:
        """The weighted estimate F (n,) [N m]."""
        (ww, ws, wa), (_, ss, sa), (_, _, aa) = self._means
        along = 1.0 / np.maximum(aa, 1e-12)
        missing, side, both = ww - wa * wa * along, ss - sa * sa * along, ws - wa * sa * along
        least, most = _EXPLAINED
        explained = both**2 / np.maximum(missing * side, 1e-300)
        share = min(self._filled / _ENOUGH, 1.0) * np.clip((explained - least) / (most - least), 0.0, 1.0)
        friction: FloatArray = share * np.clip(both / np.maximum(side, 1e-12), 0.0, self._most)
        return friction

    def update(self, sms: SpaceManipulator, q: FloatArray, v: FloatArray) -> None:
        """Update the estimate from a measured state and the law's present robot model."""
        if (step := self._measured(q, v)) is None:
            return
        qdd = step.acceleration[6:]
        if self._driven:
            needed = pin.rnea(sms.model, self._data, step.q, step.v, step.acceleration)[6:]
        else:  # without the base's acceleration, because the base's velocity is noisy
            needed = dynamics.floating_torque(sms, step.q, step.v, qdd)
        seen = np.stack([step.tau - needed, np.tanh(step.v[6:] / SLOW), qdd])
        self._smooth += self._quick * (seen - self._smooth)
        self._filled += self._slow * (1.0 - self._filled)
        self._means += self._slow * (self._smooth[:, None] * self._smooth - self._means)

    def torque(self, commanded: FloatArray) -> FloatArray:
        """Return the torques (n,) [N m] that compensate F at commanded joint rates (n,)."""
        return self.friction * np.tanh(commanded / SLOW)
