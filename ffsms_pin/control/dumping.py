"""Momentum dumping: thrusters take out of the wheels what these have gathered."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffsms_pin.actuation.allocation import WheelAllocation
from ffsms_pin.checks import FloatArray, number, positive
from ffsms_pin.errors import InvalidValue

__all__ = ["MomentumDump"]


@dataclass
class MomentumDump:
    """From when to when thrusters work against the wheels' momentum, and how fast.

    The moment on the base is -a h / time_constant, with a h the wheels' momentum as a vector; the attitude
    law has the wheels make it good, so that they slow down. It is cut down where a wheel would need more than
    half of its largest torque to follow. Source: M. J. Sidi, "Spacecraft Dynamics and
    Control", Cambridge University Press 1997, chapter 7.

    Parameters
    ----------
    above : float
        It begins where a wheel has more than this share of its largest momentum.
    below : float
        It ends where every wheel has less than this share.
    time_constant : float
        In which the momentum falls by a factor e [s].
    """

    above: float = 0.8
    below: float = 0.1
    time_constant: float = 20.0

    def __post_init__(self) -> None:
        self.time_constant = positive("dump.time_constant", self.time_constant, "s")
        if not 0.0 <= number("dump.below", self.below) < number("dump.above", self.above) <= 1.0:
            raise InvalidValue("dump", (self.below, self.above), "must have 0 <= below < above <= 1")
        self._on = False

    def reset(self) -> None:
        """Forget the last run."""
        self._on = False

    def moment(self, allocation: WheelAllocation, momentum: FloatArray) -> FloatArray:
        """Wanted moment of the thrusters (3,) [N m], root axes, at wheel momenta (w,); zero where idle."""
        wheels = allocation.wheels
        share = float((np.abs(momentum) / wheels.momentum).max())
        self._on = share > (self.below if self._on else self.above)
        if not self._on:
            return np.zeros(3)
        wanted = -wheels.total(momentum) / self.time_constant
        needed = float((np.abs(allocation.changes(wanted)) / (0.5 * wheels.torque)).max())
        return wanted / max(1.0, needed)
