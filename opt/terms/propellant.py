"""Little propellant as a term."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ffsms_pin.actuation.thrusters import STANDARD_GRAVITY
from ffsms_pin.checks import at_least_zero, positive
from ffsms_pin.opt.batch.thrusters import thruster_shares
from ffsms_pin.opt.motion import Features
from ffsms_pin.opt.motion.feature import root_of_size
from ffsms_pin.opt.terms.term import Term, time_scale

__all__ = ["Propellant"]


@dataclass(frozen=True)
class Propellant(Term):
    """Little propellant of the thrusters that hold attitude or place; nothing where no thrusters do.

    Forces follow from the force and the moment that hold the base (`opt.batch.thrusters`), shared by the
    pseudo-inverse; each force that a thruster would have to pull counts as if an opposed one pushed it. For
    thrusters in opposed pairs that is what `Trajectory.propellant` says; for others it is a smooth stand-in.

    Attributes
    ----------
    weight : float
        On the propellant [s/g, for a motion of 8 s].
    rounding : float
        Force of a thruster below which its size is rounded off [N].
    """

    weight: float = 0.1
    rounding: float = 1e-3
    name = "propellant"

    def __post_init__(self) -> None:
        at_least_zero("weight", self.weight)
        positive("rounding", self.rounding, "N")

    def residual(self, m: Features) -> Any:
        """The square root of each thruster's flow, at instants that have a weight."""
        thrusters = m.motions.thrusters
        if thrusters is None:
            return []
        flow = 1e3 / (thrusters.specific_impulse * STANDARD_GRAVITY)  # [g/s] a newton
        forces: Any = thruster_shares(m.motions) @ m.weighted().wrench
        return np.sqrt(self.weight * flow) * time_scale(m) * root_of_size(forces, self.rounding)
