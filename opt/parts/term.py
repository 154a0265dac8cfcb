"""What a term is: something that a motion should be like, as residuals whose squares add up."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ffsms_pin.checks import FloatArray, at_least_zero
from ffsms_pin.opt.motion.features import Features
from ffsms_pin.opt.parts.reading import Formula, formulas, residuals_of

if TYPE_CHECKING:
    from ffsms_pin.opt.motion.motions import Motions
    from ffsms_pin.opt.step.state import StepState

# [s] Weights of motion are those of a motion this long. Times count in eighths of the duration, so that the
# same joint motion, done in any time, has the same proportion between its cost integral and what it weighs.
REFERENCE_TIME = 8.0


def time_scale(motions: Motions | Features) -> float:
    """The unit of time in which motion is weighed: 1 for a motion of 8 s."""
    return motions.duration / REFERENCE_TIME


class Term(ABC):
    """What a motion should be like: the integral of squared residuals is its share of the objective.

    Make a subclass in a file of your own and hand it to `opt.Problem(terms=[...])`: see docs/own-parts.md.

    Attributes
    ----------
    name : str
        Key of `Trajectory.shares`.
    tie_breaker : bool
        Whether the term only decides between motions that cost the same in the other terms.
    smooths : bool
        Whether the term weighs more at the beginning of a search, where it leads round poor minima.
    step_weight : float
        On the squared residual in single steps, where it decides what the arm does with motion to spare:
        small beside the weight 1 of a step's direction. 0: only whole motions see the term.
    measures_cost : bool
        Whether motions are called cheap by this term alone, and by its `cost`: the residual may be smoothed
        while a search is on its way.
    kappa : float or None
        Sharpness of the paper's C~ where the term has one: what a motion reports is measured with it.
    """

    name: str
    tie_breaker: bool = False
    smooths: bool = False
    step_weight: float = 0.0
    measures_cost: bool = False
    kappa: float | None = None

    @abstractmethod
    def residual(self, m: Any) -> Formula:
        """What is to be small at every instant, the square root of the weight in it.

        A feature (S, K) or (c, S, K) made of `m`, the `opt.Features` of whole motions, or a list of these.
        """

    def step_objective(self, step: StepState) -> tuple[FloatArray, FloatArray] | None:
        """Matrix W (n, n) and vector w (n,) that a step adds to its objective as u^T W u / 2 - w^T u.

        u are the joint rates at the step's end; they rank below the direction and the speed of the end
        effector. Default: with `step_weight`, rates that take the residual to zero at 1 /s.
        """
        if self.step_weight == 0.0:
            return None
        seen = step.features
        W, w = np.zeros((step.sms.n, step.sms.n)), np.zeros(step.sms.n)
        for one in formulas(self, "residual", seen):
            if one.where is None:  # features at some instants are of whole motions
                value, flow, drift, jump = seen.change(one)
                known = np.isfinite(value)  # as the goal is not
                J, asked = (flow + jump)[known], (jump @ step.rates - value - drift)[known]
                W += self.step_weight * J.T @ J
                w += self.step_weight * J.T @ asked
        return W, w

    def cost(self, m: Features) -> FloatArray:
        """What the term comes to (S,) without smoothing: the integral of its squared residuals."""
        squares = (one.squares(m.weights, m.count) for one in residuals_of(self, m))
        return sum(squares, np.zeros(m.count))

    def share(self, motion: Motions) -> float:
        """What it comes to for one finished motion, at its nodes and the middles between; default: `cost`."""
        return float(self.cost(Features(motion))[0])


@dataclass(frozen=True)
class WeightedTerm(Term):
    """A term with a weight, at least zero."""

    weight: float = 1.0

    def __post_init__(self) -> None:
        at_least_zero("weight", self.weight)
