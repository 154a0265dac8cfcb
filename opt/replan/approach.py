"""What re-plans from noisy measurements ask for: to come nearer to the goal, and not to go away from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ffsms_pin.opt.goals import Place
from ffsms_pin.opt.goals.of_another import OfAnother
from ffsms_pin.opt.motion import Features
from ffsms_pin.opt.terms.term import Term

__all__ = ["Approach", "Narrower"]

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

    def residual(self, m: Features) -> Any:
        """The speed with which the distance grows [m/s], zero where it shrinks."""
        way = m.goal - m.tip
        growth = -way.dot(m.velocity) / way.norm(_NEAR)
        return np.sqrt(self.weight) * np.maximum(growth, 0.0)


@dataclass(frozen=True, eq=False)
class Narrower(OfAnother):
    """The same goal with a tenth of its tolerance, which is left to what the model does not know."""

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "tolerance", _SHARE * self.goal.tolerance)

    def place(self, t: float) -> Place:
        """The other's."""
        return self.goal.place(t)

    def approach(self, duration: float) -> list[tuple[float, Place]]:
        """The other's."""
        return self.goal.approach(duration)
