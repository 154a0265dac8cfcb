"""What plans from noisy measurements are like besides: they come nearer to the goal, and nothing else."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ffsms_pin.opt.motion import Features
from ffsms_pin.opt.terms.term import Term

__all__ = ["Approach"]


@dataclass(frozen=True)
class Approach(Term):
    """The distance to the goal does not grow, with noisy sensors.

    Near a configuration in which the arm cannot correct one direction, a way there and back would turn the
    base a little, and bring the plan's end nearer by micrometres that the model's errors exceed. With the
    default weight [s/m^2] a retreat of 1 cm in half a second weighs as much as a miss of half a millimetre.
    """

    weight: float = 100.0
    name = "approach"

    def residual(self, m: Features) -> Any:
        """The speed with which the distance grows [m/s], zero where it shrinks."""
        way = m.goal - m.tip
        growth = -way.dot(m.velocity) / way.norm(1e-3)  # [m] nearer than that its direction is noise
        return np.sqrt(self.weight) * np.maximum(growth, 0.0)
