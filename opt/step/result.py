"""The result of one step of the paper's method."""

from __future__ import annotations

from typing import NamedTuple

from ffsms_pin.checks import FloatArray

__all__ = ["Step"]


class Step(NamedTuple):
    """The result of one step.

    Attributes
    ----------
    alpha : ndarray, shape (n,)
        The paper's scaling factors: joint_rates = V alpha.
    joint_rates : ndarray, shape (n,)
        At the step's end [rad/s]; the acceleration during the step is constant.
    cos_theta : float
        Coupling assistance of these rates at the step's start.
    entropy : float
        H_norm at the step's start.
    cost : float
        The paper's summand (C~ - (1 - H_norm))^2.
    solved : bool
        False where the programme was not solved and the arm brakes within its limits instead.
    slack : float
        How far the limits that may give way did [m/s]; zero where all of them are kept.
    """

    alpha: FloatArray
    joint_rates: FloatArray
    cos_theta: float
    entropy: float
    cost: float
    solved: bool
    slack: float = 0.0
