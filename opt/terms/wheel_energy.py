"""Little energy of the wheels as a term."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ffsms_pin.checks import at_least_zero, positive
from ffsms_pin.opt.motion import Features
from ffsms_pin.opt.motion.feature import root_of_size
from ffsms_pin.opt.terms.term import Term, time_scale

__all__ = ["WheelEnergy"]


@dataclass(frozen=True)
class WheelEnergy(Term):
    """Little energy of the wheels that hold the attitude; nothing where no wheels do.

    The energy is the integral of the sum of |motor torque x wheel speed|: wheels win nothing back in braking
    (`Trajectory.wheel_energy`). Its slopes take a call of Pinocchio an instant, which makes a search slower.

    Attributes
    ----------
    weight : float
        On the energy [s/J, for a motion of 8 s].
    rounding : float
        Power of a wheel below which its size is rounded off [W]: the share is less than the energy by at most
        so much a wheel.
    """

    weight: float = 1.0
    rounding: float = 1e-3
    name = "wheel energy"

    def __post_init__(self) -> None:
        at_least_zero("weight", self.weight)
        positive("rounding", self.rounding, "W")

    def residual(self, m: Features) -> Any:
        """The square root of each wheel's power, at instants that have a weight."""
        wheels = m.motions.wheels
        if wheels is None:
            return []
        at = m.weighted()
        power = at.wheel_torques * at.wheels / wheels.inertia
        return np.sqrt(self.weight) * time_scale(m) ** 1.5 * root_of_size(power, self.rounding)
