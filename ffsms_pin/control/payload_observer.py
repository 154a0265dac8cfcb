"""The estimation of a payload on the end effector during a controlled motion."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray
from ffsms_pin.control.step_observer import StepObserver
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system import dynamics
from ffsms_pin.system.regressors import PER_BODY, parameters_of, pseudo_inertia, torque_regressor

_SMOOTHING, _WINDOW = 0.05, 2.0  # [s] time constants of the smoothed measurements and of the sums
_PERIOD = 0.02  # [s] between two least squares solutions
_SHARE = 0.1  # prior deviation from no payload, as a share of the robot's mass and of the arm's length
_NOISE = 2e-3  # [m/s^2, rad/s^2] assumed standard deviation of the noise in the averaged rows
_LEAST = 1e-5  # [m/s^2, rad/s^2] least size of the base's rows; smaller rows may be rounding errors
_EXPLAINED = 0.9  # adjusted coefficient of determination above which a payload is accepted
_WORSE = 2.0  # an accepted payload is dropped if it increases the variance of the base's rows by this factor
_ROUNDS = 10  # largest number of iterations of a solution, warm-started from the last solution
_CONVERGED = 1e-4  # relative change in an iteration at convergence
_CHANGE = 0.02  # relative change of the payload above which the robot model is updated


class PayloadObserver(StepObserver):
    """An estimator of the ten inertial parameters of a payload by regression of the missing force.

    Over a control step the measured velocities change by dt a. Let M be the inertia matrix and b the
    nonlinear effects at the middle of the step, and tau the joint torques less the expected friction. Without
    a force on the base, the missing force is w = [0; tau] - M a - b. For a payload with the parameters phi,
    w = Y phi, where Y(q, v, a) is the regressor of the end effector's link. The rows of w and Y are divided
    by the diagonal of M and averaged over 0.05 s. phi is the least squares solution among the physically
    consistent parameters, with a forgetting time of 2 s. The prior is around the last solution, at first
    zero.

    phi is accepted if it explains 90 % of the variance of the base's rows (adjusted coefficient of
    determination). Joint torques do not enter these rows, so friction, weak drives and failed joints cannot
    be mistaken for a payload, but external forces can. For a robot with wheels the moments on the base are
    left out, because the wheel torques are not measured.

    Parameters
    ----------
    sms : SpaceManipulator
        The robot, without thrusters.
    dt : float
        Control step [s].
    viscous, coulomb : array_like
        The expected friction of the joints [N m s/rad], [N m].

    Attributes
    ----------
    sms : SpaceManipulator
        The robot without the payload.
    robot : SpaceManipulator
        `sms` with the estimated payload; `sms` itself until a payload is accepted.
    """

    def __init__(
        self, sms: SpaceManipulator, dt: float, viscous: ArrayLike = 0.0, coulomb: ArrayLike = 0.0
    ) -> None:
        super().__init__(sms, dt, viscous, coulomb)
        self.sms = self.robot = sms
        self._body = sms.tip_joint
        self._columns = slice(PER_BODY * (self._body - 1), PER_BODY * self._body)
        base = 6 if sms.wheels is None else 3
        self._rows = np.r_[:base, 6 : 6 + sms.n]
        self._base = slice(base)
        mass = sum(body.mass for body in sms.model.inertias)
        length = _SHARE * sms.arm_stack().length
        self._scales = _SHARE * mass * np.repeat([1.0, length, length**2], [1, 3, 6])
        self._length = np.array([length, length, length, 1.0])
        self._quick, self._slow = -math.expm1(-dt / _SMOOTHING), -math.expm1(-dt / _WINDOW)
        self._prior = _NOISE**2 * self._slow * np.eye(PER_BODY)
        self._every = max(1, round(_PERIOD / dt))
        self._seen, self._smooth = np.zeros((2, len(self._rows), PER_BODY + 1))
        self._all, self._of_base = np.zeros((2, PER_BODY + 1, PER_BODY + 1))
        self._share, self._near, self._steps = np.zeros(PER_BODY), np.zeros(PER_BODY), 0

    def update(self, q: FloatArray, v: FloatArray) -> None:
        """Update the estimate from a measured state."""
        if (step := self._measured(q, v)) is None:
            return
        acting = np.concatenate([np.zeros(6), step.tau])
        missing = acting - pin.rnea(self._model, self._data, *step[:3])
        Y = torque_regressor(self.sms, *step[:3])[:, self._columns]
        if self._steps % self._every == 0:
            self._inertias = np.diag(dynamics.inertia_matrix(self.sms, step.q))[self._rows, None]
        self._seen[:, :-1], self._seen[:, -1] = Y[self._rows] * self._scales, missing[self._rows]
        self._smooth += self._quick * (self._seen / self._inertias - self._smooth)
        on_base = self._smooth[self._base]
        self._all += self._slow * (self._smooth.T @ self._smooth - self._all)
        self._of_base += self._slow * (on_base.T @ on_base - self._of_base)
        self._steps += 1
        if self._steps % self._every == 0:
            self._solve()

    def _solve(self) -> None:
        """Accept a payload that explains the missing force, or drop an accepted payload that increases it."""
        count = (self._base.stop / _SMOOTHING) * min(self._steps * self._dt, _WINDOW)  # independent rows
        left = count - PER_BODY - 1.0
        if left <= 0.0 or self._of_base[-1, -1] < _LEAST**2:
            return
        most = (1.0 - _EXPLAINED) * left / (count - 1.0)
        inverse = np.asarray(np.linalg.inv(self._all[:-1, :-1] + self._prior), dtype=np.float64)
        share = self._fit(inverse, self._near)
        if self._unexplained(share) <= most:
            share = self._near = self._consistent(inverse)
        if self._unexplained(share) > most:
            if not self._share.any() or self._unexplained(self._share) <= _WORSE:
                return
            share = np.zeros(PER_BODY)
        if np.abs(share - self._share).max() <= _CHANGE * np.abs(share).max():
            return
        self._share = share
        bodies = list(self.sms.model.inertias)[1:]
        own = bodies[self._body - 1].toDynamicParameters()
        bodies[self._body - 1] = pin.Inertia.FromDynamicParameters(own + share * self._scales)
        self.robot = self.sms.with_inertias(bodies)

    def _unexplained(self, share: FloatArray) -> float:
        """Return the share of the base rows' variance that a payload does not explain."""
        x = np.append(-share, 1.0)
        return float(x @ self._of_base @ x) / max(float(self._of_base[-1, -1]), 1e-300)

    def _consistent(self, inverse: FloatArray) -> FloatArray:
        """Return physically consistent parameters (10,) near the best fit, in prior standard deviations.

        Least squares solutions alternate with projections on the consistent parameters. Each solution uses
        the `inverse` (10, 10) of the normal matrix and a prior around the last projection, so mainly
        unobservable parameters change.
        """
        units, share = np.outer(self._length, self._length), self._near
        for _ in range(_ROUNDS):
            fit = self._fit(inverse, share)
            values, axes = np.linalg.eigh(pseudo_inertia(fit * self._scales) / units)
            if values[0] >= 0.0:
                return fit
            before, P = share, (axes * np.maximum(values, 0.0)) @ axes.T * units
            share = parameters_of(P) / self._scales
            if np.abs(share - before).max() <= _CONVERGED * np.abs(share).max():
                break
        return share

    def _fit(self, inverse: FloatArray, near: FloatArray) -> FloatArray:
        """Return the least squares solution (10,) with the prior around `near` (10,)."""
        return np.asarray(inverse @ (self._all[:-1, -1] + self._prior @ near))
