"""The measured control steps, and the base class of the observers of friction and payload."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ffsms_pin.actuation.wheels import friction_torque
from ffsms_pin.checks import FloatArray
from ffsms_pin.robot import SpaceManipulator


class MeasuredStep(NamedTuple):
    """A control step between two measured states.

    Attributes
    ----------
    q, v : ndarray, shape (nq,), (6 + n,)
        The state at the middle of the step, with the mean velocity.
    acceleration : ndarray, shape (6 + n,)
        The change of the velocity over the step, divided by the control step [m/s^2; rad/s^2].
    tau : ndarray, shape (n,)
        The applied joint torques less the expected friction [N m].
    """

    q: FloatArray
    v: FloatArray
    acceleration: FloatArray
    tau: FloatArray


class StepObserver:
    """The base class of observers that compare measured accelerations with those of a model.

    Parameters
    ----------
    sms : SpaceManipulator
    dt : float
        Control step [s].
    viscous, coulomb : array_like
        The expected friction of the joints [N m s/rad], [N m].
    """

    def __init__(self, sms: SpaceManipulator, dt: float, viscous: ArrayLike, coulomb: ArrayLike) -> None:
        self._model, self._data, self._dt = sms.model, sms.model.createData(), dt
        self._viscous, self._coulomb = np.asarray(viscous), np.asarray(coulomb)
        self._last: tuple[FloatArray, FloatArray, FloatArray] | None = None

    def acted(self, q: FloatArray, v: FloatArray, tau: FloatArray) -> None:
        """Store the measured state and the torques (n,) [N m] at the beginning of a control step."""
        self._last = q.copy(), v.copy(), tau

    def _measured(self, q: FloatArray, v: FloatArray) -> MeasuredStep | None:
        """Return the step that ends at a measured state; None before the first step."""
        if self._last is None:
            return None
        q0, v0, tau = self._last
        mean = 0.5 * (v0 + v)
        middle = pin.integrate(self._model, q0, 0.5 * self._dt * mean)
        tau = tau + friction_torque(mean[6:], self._viscous, self._coulomb)
        return MeasuredStep(middle, mean, (v - v0) / self._dt, tau)
