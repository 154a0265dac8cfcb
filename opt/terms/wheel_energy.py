"""Little energy of the wheels as a term."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffsms_pin.checks import at_least_zero, positive
from ffsms_pin.opt.batch.instants import Instants
from ffsms_pin.opt.batch.motions import Motions
from ffsms_pin.opt.batch.residual import Residuals
from ffsms_pin.opt.batch.smooth_size import smooth_size
from ffsms_pin.opt.batch.wheels import (
    TorqueSlopes,
    friction_slope,
    momentum_slopes_by_joints,
    wheel_momentum,
    wheel_shares,
    wheel_torque,
)
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

    def residual(self, motions: Motions) -> Residuals:
        """The square root of each wheel's power, at instants that have a weight."""
        wheels = motions.wheels
        if wheels is None:
            return []
        h = wheel_momentum(motions)
        torque = wheel_torque(motions, h)
        instants = Instants.weighted(motions)
        motion, instant = instants
        by_torque = TorqueSlopes(motions.stack.robot).at(*instants.columns(motions))
        by_momentum = [slope[:, :, motion, instant] for slope in momentum_slopes_by_joints(motions)]
        root = np.sqrt(self.weight) * time_scale(motions) ** 1.5
        found: Residuals = []
        for i, share in enumerate(wheel_shares(wheels)):
            speed, tau = h[i, motion, instant] / wheels.inertia[i], torque[i, motion, instant]
            value, slope = smooth_size(tau * speed, self.rounding)
            # By the momentum: as the speed, and what friction takes.
            by_h = tau / wheels.inertia[i]
            if wheels.rubs:
                by_h = by_h + speed * friction_slope(wheels, np.full(len(motion), i), h[i, motion, instant])
            by = [-speed * np.einsum("x,xjv->jv", share, one) for one in by_torque]
            for kind, one in enumerate(by_momentum):
                by[kind] -= by_h * np.einsum("x,xjv->jv", share, one)
            found.append(instants.residual(root * value, [root * slope * one for one in by]))
        return found
