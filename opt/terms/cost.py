"""The paper's cost of one step, and the direction of motion at which it vanishes."""

from __future__ import annotations

import math

from ffsms_pin.checks import number, positive

__all__ = ["ideal_cosine", "soft_assistance", "step_cost"]


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
    """The cosine c* at which the cost of a step is zero, or the nearest one in [-1, 1].

    Solving C~ = 1 - H_norm for the cosine gives c* = log(exp(kappa (1 - H_norm)) - 1) / kappa: the paper
    asks the end effector to move on a cone around the direction to the target.

    Parameters
    ----------
    entropy : float
        H_norm, in [0, 1].
    kappa : float
        Sharpness, above zero; of any size.
    """
    kappa = positive("kappa", kappa)
    x = kappa * (1.0 - number("entropy", entropy))
    if x <= 0.0:
        return -1.0
    # log(exp(x) - 1) = x + log(1 - exp(-x)), without overflow.
    cosine = (x + math.log(-math.expm1(-x))) / kappa
    return min(1.0, max(-1.0, cosine))
