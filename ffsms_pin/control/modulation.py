"""Pulse-width modulation: thrusters that are on or off give a wanted force on average."""

from __future__ import annotations

import numpy as np

from ffsms_pin.actuation import Thrusters
from ffsms_pin.checks import FloatArray, frozen, instance, positive, sized
from ffsms_pin.errors import InvalidValue

__all__ = ["PulseWidth"]


class PulseWidth:
    """Turns wanted forces into pulses, one a period, each from the period's start.

    A pulse is a whole number of control steps and no shorter than the least on-time. The impulse that a
    period leaves out, since it is too little for a pulse, is kept for the next ones, so that the mean force
    is the wanted one. What more than a whole period is missing is dropped: the thruster is too weak.

    Source: the pulse-width modulation of W. E. Vander Velde and J. He, "Design of space structure control
    systems using on-off thrusters", Journal of Guidance, Control, and Dynamics 6 (1983), with the remainder
    carried on as in sigma-delta modulation.

    Parameters
    ----------
    thrusters : Thrusters
        On or off.
    dt : float
        Control step [s].

    Raises
    ------
    InvalidValue
        The least on-time is no longer than the period allows, or the control step exceeds it.
    """

    def __init__(self, thrusters: Thrusters, dt: float) -> None:
        instance("thrusters", thrusters, Thrusters)
        dt = positive("dt", dt, "s")
        if thrusters.period is None or thrusters.period < dt * (1.0 - 1e-9):
            raise InvalidValue("thrusters.period", thrusters.period, f"must be at least a step of {dt:g} s")
        self._force = thrusters.force
        self._steps = max(1, round(thrusters.period / dt))
        self._least = min(self._steps, max(1, int(np.ceil(thrusters.least_on_time / dt - 1e-9))))
        self._wanted = np.zeros(len(thrusters))  # sum of the wanted shares since the last period began
        self._on = np.zeros(len(thrusters))  # steps of the pulse
        self._step = 0

    def apply(self, force: FloatArray) -> FloatArray:
        """The forces (k,) [N] of this control step, each zero or the largest; `force` (k,) [N] is wanted."""
        force = sized("force", force, len(self._force))
        if self._step == 0:
            # The last period's wish decides on this period's pulse; at the very start the wish of now.
            wish = np.round(self._wanted + 1e-9)
            self._on = np.where(wish >= self._least, np.minimum(wish, self._steps), 0.0)
            self._wanted = np.minimum(self._wanted - self._on, float(self._steps))
        self._wanted = self._wanted + np.clip(force / self._force, 0.0, 1.0)
        burning = self._step < self._on
        self._step = (self._step + 1) % self._steps
        return frozen(np.where(burning, self._force, 0.0))
