"""The paper's cost as a term, and the two that make motions plain: little travel, small accelerations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray, at_least_zero, positive
from ffsms_pin.opt.motion import Feature, Features, Motions
from ffsms_pin.opt.terms.term import Term, time_scale

__all__ = ["Coupling", "Effort", "Smooth"]

_TINY_WAY = 1e-5  # [m] keeps the direction to the target defined
_TINY_SPEED = 1e-6  # [m/s] and that of motion
# Default weights: they decide only between motions of equal cost.
_LIGHT_EFFORT, _LIGHT_SMOOTH = 1e-4, 1e-5


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

    def residual(self, m: Features) -> Any:
        """C~ - (1 - H_norm), smoothed as `m.smoothing` says."""
        fade_speed, fade_distance = m.smoothing
        exact, length, speed = self._exact(m)
        near = length / np.hypot(length, fade_distance)
        fade = speed / np.hypot(speed, fade_speed * m.mean_speed)
        return np.sqrt(self.weight) * near * fade * exact

    def cost(self, motions: Motions) -> FloatArray:
        """The paper's cost integral (S,) [s] times the weight, whatever the smoothing."""
        exact, _, _ = self._exact(Features(motions))
        result: FloatArray = exact.value**2 @ motions.weights
        return self.weight * result

    def _exact(self, m: Features) -> tuple[Any, Feature, Feature]:
        """The residual without smoothing, the way's length and the speed."""
        velocity = m.velocity
        way = m.goal - m.tip + m.lag * velocity
        length, speed = way.norm(_TINY_WAY), velocity.norm(_TINY_SPEED)
        cosine: Any = way.dot(velocity) / (length * speed)
        return np.logaddexp(0.0, self.kappa * cosine) / self.kappa - (1.0 - m.entropy), length, speed

    def share(self, motion: Motions) -> float:
        """The paper's own sum over the steps."""
        step = float(motion.times[2] - motion.times[0])
        return self.weight * float(motion.paired.cost(self.kappa).sum()) * step


@dataclass(frozen=True)
class Effort(Term):
    """Little joint travel.

    Attributes
    ----------
    weight : float
        On the integral of the squared joint rates [s^2/rad^2, for a motion of 8 s]. The default makes a
        motion that turns joints by 3 rad more cost as much as 1e-3 s of the paper's cost integral.
    idle : float
        How many times as much the square counts of a joint that does not move the end effector, such as those
        of a second arm. The paper's cost may fall by some 1e-4 s where an idle arm swings; with the default
        that is seldom worth it, while terms and limits of the base still are.
    """

    weight: float = _LIGHT_EFFORT
    idle: float = 100.0
    name = "effort"
    smooths = True

    def __post_init__(self) -> None:
        at_least_zero("weight", self.weight)
        at_least_zero("idle", self.idle)

    @property
    def tie_breaker(self) -> bool:
        """Whether the weight is no greater than the default; a greater one is paid for with cost."""
        return self.weight <= _LIGHT_EFFORT

    def residual(self, m: Features) -> Any:
        """The joint rates."""
        idle = np.where(m.stack.moves_tip == 0.0, np.sqrt(self.idle), 1.0)
        return np.sqrt(self.weight) * time_scale(m) * idle * m.rates


@dataclass(frozen=True)
class Smooth(Term):
    """Small joint accelerations.

    Attributes
    ----------
    weight : float
        On the integral of the squared accelerations [s^4/rad^2, for a motion of 8 s]. The default is small:
        it decides between motions of equal cost.
    """

    weight: float = _LIGHT_SMOOTH
    name = "smooth"
    smooths = True

    def __post_init__(self) -> None:
        at_least_zero("weight", self.weight)

    @property
    def tie_breaker(self) -> bool:
        """Whether the weight is no greater than the default; a greater one is paid for with cost."""
        return self.weight <= _LIGHT_SMOOTH

    def residual(self, m: Features) -> Any:
        """The joint accelerations."""
        return np.sqrt(self.weight) * time_scale(m) ** 2 * m.accelerations
