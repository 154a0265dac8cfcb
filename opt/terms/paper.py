"""The paper's cost, of a step and as a term, and the two that make motions plain: Effort and Smooth."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray, at_least_zero, number, positive
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.motion import Feature, Features, Motions
from ffsms_pin.opt.motion.motions import EXACT
from ffsms_pin.opt.terms.term import Term, WeightedTerm, time_scale

__all__ = ["Coupling", "Effort", "Smooth", "ideal_cosine", "soft_assistance", "step_cost"]


def soft_assistance(cos_theta: float, kappa: float) -> float:
    """C~ = log(1 + exp(kappa cos(theta_a))) / kappa, the smooth max(0, cos(theta_a)) of the paper.

    Parameters
    ----------
    cos_theta : float
        Coupling assistance, in [-1, 1].
    kappa : float
        Sharpness, above zero; of any size.
    """
    kappa = positive("kappa", kappa)
    x = kappa * number("cos_theta", cos_theta)
    # log(1 + exp(x)) without overflow, as numpy's logaddexp(0, x).
    return (max(x, 0.0) + math.log1p(math.exp(-abs(x)))) / kappa


def step_cost(cos_theta: float, entropy: float, kappa: float) -> float:
    """The summand (C~ - (1 - H_norm))^2 of the paper's cost (Eq. optimal_cost)."""
    return (soft_assistance(cos_theta, kappa) - (1.0 - number("entropy", entropy))) ** 2


def ideal_cosine(entropy: float, kappa: float) -> float:
    """The cosine at which the cost of a step with this H_norm is zero, or the nearest one in [-1, 1].

    C~ = 1 - H_norm gives log(exp(kappa (1 - H_norm)) - 1) / kappa: the paper asks the end effector to move on
    a cone around the direction to the target.
    """
    return kernel.ideal_cosine(number("entropy", entropy), positive("kappa", kappa))


@dataclass(frozen=True)
class Coupling(Term):
    """The paper's cost (C~ - (1 - H_norm))^2, integrated over time (Eq. optimal_cost).

    Its residual does not see speed, and jumps where the end effector stands still or has arrived. While a
    search is on its way two factors take it to zero there (`Smoothing`); a finished motion is judged on the
    true one.

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
        exact, length, speed = self._exact(m)
        if m.smoothing == EXACT:
            return np.sqrt(self.weight) * exact
        fade_speed, fade_distance = m.smoothing
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
        length, speed = way.norm(rounding=1e-5), velocity.norm(rounding=1e-6)
        cosine: Any = way.dot(velocity) / (length * speed)
        return np.logaddexp(0.0, self.kappa * cosine) / self.kappa - (1.0 - m.entropy), length, speed

    def share(self, motion: Motions) -> float:
        """The paper's own sum over the steps."""
        step = float(motion.times[2] - motion.times[0])
        return self.weight * float(motion.paired.cost(self.kappa).sum()) * step


class _Plain(WeightedTerm):
    """Makes a motion plain; with no more than the default weight it decides between motions of equal cost."""

    smooths = True

    @property
    def tie_breaker(self) -> bool:  # type: ignore[override]  # plain elsewhere
        """Whether the weight is no greater than the default; a greater one is paid for with cost."""
        return self.weight <= type(self).weight


@dataclass(frozen=True)
class Effort(_Plain):
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

    weight: float = 1e-4
    idle: float = 100.0
    name = "effort"

    def __post_init__(self) -> None:
        super().__post_init__()
        at_least_zero("idle", self.idle)

    def residual(self, m: Features) -> Any:
        """The joint rates."""
        idle = np.where(m.stack.moves_tip == 0.0, np.sqrt(self.idle), 1.0)
        return np.sqrt(self.weight) * time_scale(m) * idle * m.rates


@dataclass(frozen=True)
class Smooth(_Plain):
    """Small joint accelerations; `weight` is on the integral of their squares [s^4/rad^2, for 8 s]."""

    weight: float = 1e-5
    name = "smooth"

    def residual(self, m: Features) -> Any:
        """The joint accelerations."""
        return np.sqrt(self.weight) * time_scale(m) ** 2 * m.accelerations
