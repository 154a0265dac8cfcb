"""What re-plans from noisy measurements ask for: to come nearer to the goal, and not to go away from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffsms_pin.opt.batch.motions import Motions
from ffsms_pin.opt.batch.residual import Residual, Residuals
from ffsms_pin.opt.goals import Changed, Goal
from ffsms_pin.opt.terms.term import Term
from ffsms_pin.system.batch.stacks import dot

__all__ = ["Approach", "narrower"]

_NEAR = 1e-3  # [m] nearer than this the direction to the goal is noise
_SHARE = 0.1  # of the tolerance


@dataclass(frozen=True)
class Approach(Term):
    """The distance to the goal does not grow.

    Near a configuration in which the arm cannot correct one direction, a way there and back would turn the
    base a little, and bring the plan's end nearer by micrometres that the model's errors exceed.

    Attributes
    ----------
    weight : float
        On the integral of the squared speed with which the distance grows [s/m^2]. With the default a retreat
        of 1 cm in half a second weighs as much as a miss of half a millimetre.
    """

    weight: float = 100.0
    name = "approach"

    def residual(self, motions: Motions) -> Residuals:
        """The speed with which the distance grows [m/s], zero where it shrinks."""
        way, velocity, root = motions.to_target, motions.velocity, np.sqrt(self.weight)
        length = np.sqrt(dot(way, way) + _NEAR**2)
        direction = way / length
        growth = -dot(direction, velocity)
        away = growth > 0.0
        # The direction turns when the end effector moves: by the part of the way across it, over the length.
        across = velocity + growth * direction
        return [
            Residual(
                root * np.where(away, growth, 0.0),
                by_velocity=np.where(away, -root * direction, 0.0),
                by_tip=np.where(away, root * across / length, 0.0),
            )
        ]


def narrower(goal: Goal) -> Goal:
    """The same goal with a tenth of its tolerance, which is left to what the model does not know."""
    return Changed(goal, tolerance=_SHARE * goal.tolerance)
