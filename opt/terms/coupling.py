"""The paper's cost as a term."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffsms_pin.checks import FloatArray, positive
from ffsms_pin.opt.batch.motions import Motions
from ffsms_pin.opt.batch.residual import Residual, Residuals
from ffsms_pin.opt.terms.term import Term
from ffsms_pin.system.batch.stacks import dot

__all__ = ["Coupling"]

_TINY_WAY = 1e-10  # [m^2] keeps the direction to the target defined
_TINY_SPEED = 1e-12  # [(m/s)^2] and that of motion


@dataclass(frozen=True)
class Coupling(Term):
    """The paper's cost (C~ - (1 - H_norm))^2, integrated over time (Eq. optimal_cost).

    Its residual does not see speed, and jumps where the end effector stands still or has arrived. While a
    search is on its way the residual is multiplied by two factors that fall to zero below a small speed and
    near the target (`Smoothing`); the finished motion is judged on the true one.

    Attributes
    ----------
    kappa : float
        Sharpness of C~. The paper does not state its own; 10 makes C~ nearly max(0, cos(theta_a)).
    weight : float
        On the integral [1/s]. 1: all other weights are relative to it.
    """

    kappa: float = 10.0
    weight: float = 1.0
    name = "coupling"
    measures_cost = True

    def __post_init__(self) -> None:
        positive("kappa", self.kappa)
        positive("weight", self.weight)

    def residual(self, motions: Motions) -> Residuals:
        """C~ - (1 - H_norm), smoothed as `motions.smoothing` says."""
        way, velocity, kappa = _way(motions), motions.velocity, self.kappa
        fade_speed, fade_distance = motions.smoothing
        length = np.sqrt(dot(way, way) + _TINY_WAY)
        speed = np.sqrt(dot(velocity, velocity) + _TINY_SPEED)
        d, e = way / length, velocity / speed
        cosine = dot(d, e)
        exact = np.logaddexp(0.0, kappa * cosine) / kappa - (1.0 - motions.entropy)

        # The velocity's parts along d and across it; `side` is the unit vector across.
        along = dot(d, velocity)
        rest = velocity - along * d
        across = np.sqrt(dot(rest, rest) + 1e-14)
        side = rest / across

        fade = speed / np.hypot(speed, fade_speed * motions.mean_speed)
        near = length / np.hypot(length, fade_distance)
        value = near * fade * exact
        # The slope of C~ by the cosine is the logistic function, written so that it cannot overflow.
        by_angle = -near * fade * np.exp(-np.logaddexp(0.0, -kappa * cosine)) * across / speed
        by_speed = value * (1.0 - fade * fade)
        # Turning the velocity away from d by an angle, and stretching it.
        away = (side * along - d * across) / speed
        root = np.sqrt(self.weight)
        by_tip = (by_angle * side - value * (1.0 - near * near) * d) / length
        by_velocity = (by_angle * away + by_speed * e) / speed - motions.lag * by_tip
        return [
            Residual(
                root * value,
                by_velocity=root * by_velocity,
                by_tip=root * by_tip,
                by_entropy=root * near * fade,
            )
        ]

    def cost(self, motions: Motions) -> FloatArray:
        """The paper's cost integral (S,) [s] times the weight, whatever the smoothing."""
        way, velocity = _way(motions), motions.velocity
        scale = np.sqrt((dot(way, way) + _TINY_WAY) * (dot(velocity, velocity) + _TINY_SPEED))
        c_soft = np.logaddexp(0.0, self.kappa * dot(way, velocity) / scale) / self.kappa
        result: FloatArray = (c_soft - (1.0 - motions.entropy)) ** 2 @ motions.weights
        return self.weight * result

    def share(self, motion: Motions) -> float:
        """The paper's own sum over the steps."""
        step = float(motion.times[2] - motion.times[0])
        return self.weight * float(motion.paired.cost(self.kappa).sum()) * step


def _way(motions: Motions) -> FloatArray:
    """From the end effector, where it was at the start of its step, to the target (3, S, K) [m]."""
    return motions.to_target + motions.lag * motions.velocity
