"""Terms of the base and of what acts on it: its turning, wheels that hold its attitude, propellant."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ffsms_pin.actuation.allocation import ThrusterAllocation
from ffsms_pin.checks import positive
from ffsms_pin.opt.motion import Features, Motions
from ffsms_pin.opt.motion.feature import root_of_size
from ffsms_pin.opt.terms.term import WeightedTerm, time_scale

__all__ = ["BaseTurn", "Propellant", "WheelEnergy", "WheelMomentum", "propellant", "wheel_energy"]


@dataclass(frozen=True)
class BaseTurn(WeightedTerm):
    """Little turning of the base.

    Attributes
    ----------
    weight : float
        On the integral of the squared angular velocity of the base [32 s^2/rad^2, for a motion of 8 s]. With
        1 a base that turns evenly by 0.05 rad costs as much as 0.01 s of the paper's cost integral: enough to
        choose between motions that are nearly free.
    """

    name = "base turn"

    def residual(self, m: Features) -> Any:
        """The angular velocity."""
        return np.sqrt(32.0 * self.weight) * time_scale(m) * m.base_spin


@dataclass(frozen=True)
class WheelMomentum(WeightedTerm):
    """Little momentum of the wheels that hold the attitude; nothing where no wheels do.

    `weight` is on the integral of the wheels' squared momenta [1/(N m s)^2 1/s, for a motion of 8 s].
    """

    name = "wheel momentum"

    def residual(self, m: Features) -> Any:
        """The momentum of each wheel."""
        return np.sqrt(self.weight) * time_scale(m) * m.wheels


@dataclass(frozen=True)
class WheelEnergy(WeightedTerm):
    """Little energy of the wheels that hold the attitude; nothing where no wheels do.

    The energy is the integral of the sum of |motor torque x wheel speed|: wheels win nothing back in braking
    (`Trajectory.wheel_energy`).

    Attributes
    ----------
    weight : float
        On the energy [s/J, for a motion of 8 s].
    rounding : float
        Power of a wheel below which its size is rounded off [W]: the share is less than the energy by at most
        so much a wheel.
    """

    rounding: float = 1e-3
    name = "wheel energy"

    def __post_init__(self) -> None:
        super().__post_init__()
        positive("rounding", self.rounding, "W")

    def residual(self, m: Features) -> Any:
        """The square root of each wheel's power, at instants that have a weight."""
        wheels = m.motions.wheels
        if wheels is None:
            return []
        at = m.weighted()
        power = at.wheel_torques * at.wheels / wheels.inertia
        return np.sqrt(self.weight) * time_scale(m) ** 1.5 * root_of_size(power, self.rounding)


@dataclass(frozen=True)
class Propellant(WeightedTerm):
    """Little propellant of the thrusters that hold attitude or place; nothing where no thrusters do.

    The force and the moment that hold the base (`Features.wrench`) are shared by the pseudo-inverse; each
    force that a thruster would have to pull counts as if an opposed one pushed it. For thrusters in opposed
    pairs that is what `Trajectory.propellant` says; for others it is a smooth stand-in.

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
        super().__post_init__()
        positive("rounding", self.rounding, "N")

    def residual(self, m: Features) -> Any:
        """The square root of each thruster's flow, at instants that have a weight."""
        thrusters = m.motions.thrusters
        if thrusters is None:
            return []
        forces: Any = ThrusterAllocation(thrusters, m.stack.base_com).shares @ m.weighted().wrench
        flow = 1e3 * thrusters.flow(np.ones(1))  # [g/s] a newton
        return np.sqrt(self.weight * flow) * time_scale(m) * root_of_size(forces, self.rounding)


def wheel_energy(motion: Motions) -> float:
    """Integral over one motion of the sum of |motor torque x wheel speed| [J], by its steps' middles."""
    if motion.wheels is None:
        return 0.0
    m = Features(motion)
    power = np.abs(m.wheel_torques.value * m.wheels.value / motion.wheels.inertia[:, None, None])
    return float(power[:, 0, 1::2].sum()) * float(motion.times[2] - motion.times[0])


def propellant(motion: Motions) -> float:
    """What thrusters that hold the base use over one motion [kg], by the law's own sharing of forces.

    As proportional thrusters would give them; pulses of the same mean use the same.
    """
    thrusters = motion.thrusters
    if thrusters is None:
        return 0.0
    allocation = ThrusterAllocation(thrusters, motion.stack.base_com)
    wrenches = motion.forces[-6:, 0, 1::2].T
    flow = [thrusters.flow(allocation.forces(row[:3], row[3:])) for row in wrenches]
    return float(np.sum(flow)) * float(motion.times[2] - motion.times[0])
