"""The options of re-planning, each with its unit and reason, and a cost of its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np

from ffsms_pin.checks import FloatArray, at_least_zero
from ffsms_pin.opt.costs import Term
from ffsms_pin.opt.derivatives import Variables
from ffsms_pin.opt.search.spline import Grid
from ffsms_pin.options import Angle, NotNegative, PerJointPositive, Positive, Unit


@dataclass(frozen=True, eq=False)
class ReplanOptions:
    """The options of the receding horizon.

    Raises
    ------
    InvalidValue
        A negative number.
    """

    period: Annotated[Positive, Unit("s")] = 0.1
    """The time between two re-plans of the rest of the motion, and never more than a tenth of the time left,
    in which a base that moves by centimetres a second is not astray."""
    arrived_miss: float = 2e-3
    """The miss [m] within which a plan arrives: a tenth of the paper's r_th, twice the tolerance of plans."""
    search_again: float = 1.0
    """The least time [s] between two whole searches, which are made if the rest of a plan does not arrive or
    breaks a limit; and at most one in a quarter of the time left."""
    dead_band: Annotated[NotNegative | None, Unit("m", "from the sensors")] = None
    """The distance from a goal that stands still within which an arm rests after the deadline. Default: three
    times the noise of its measured place, from 0.1 to 1 mm; none with perfect sensors."""
    settle: float = 0.1
    """The time [s] in which an error that is left after the deadline is closed if sensors are noisy or late;
    with a limit on the jerk, five times that."""
    jerk: Annotated[PerJointPositive | None, Angle("rad/s³ or m/s³", "none")] = None
    """The limit on the change of the commanded accelerations, as far as the other limits allow; per joint."""
    # Spline of the changes: one that is finer near the deadline makes them there, in no time.
    grid: ClassVar[Grid] = Grid(16, 2, 3)

    def __post_init__(self) -> None:
        for name in ("period", "arrived_miss", "search_again", "settle"):
            at_least_zero(name, getattr(self, name))
        at_least_zero("dead_band", self.band(None), "m")

    def band(self, noise: float | None) -> float:
        """Return the dead band [m], for sensors of which `noise` [m] is known; None: they are perfect."""
        if self.dead_band is not None:
            return self.dead_band
        return 0.0 if noise is None else min(max(3.0 * noise, 1e-4), 1e-3)

    def rests(self, distance: float, noise: float | None, rested: bool) -> bool:
        """Return whether an arm rests at a distance [m] after the deadline, first well inside the band."""
        return distance < self.band(noise) / (1.0 if rested else 3.0)


@dataclass(frozen=True, eq=False)
class Nearby(Term):
    """The joint accelerations are near those (n, 1, K) of the plan that a search has found.

    With the default weight [s^3/rad^2] a miss by a tenth of the tolerance weighs as much as 0.1 rad/s^2 all
    the time: a re-plan makes good what the goal asks for, but not by hurrying at the last moment.
    """

    accelerations: FloatArray
    weight: float = 1e-2
    name = "nearby"

    def residual(self, m: Variables) -> Any:
        """Return the change of the accelerations."""
        return self.weight**0.5 * (m.accelerations - self.accelerations)


@dataclass(frozen=True)
class Approach(Term):
    """The distance to a goal that stands still does not grow.

    Near a configuration in which the arm cannot correct one direction, a way there and back would turn the
    base a little, and bring the plan's end nearer by micrometres that the model's errors exceed. With the
    default weight [s/m^2] a retreat of 1 cm in half a second weighs as much as a miss of half a millimetre.
    """

    weight: float = 100.0
    name = "approach"

    def residual(self, m: Variables) -> Any:
        """Return the speed with which the distance grows [m/s], zero where it shrinks."""
        displacement = m.goal - m.tip
        growth = -displacement.dot(m.velocity) / displacement.norm(
            1e-3
        )  # [m] nearer than that its direction is noise
        return np.sqrt(self.weight) * np.maximum(growth, 0.0)
