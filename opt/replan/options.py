"""The options of re-planning, and the additional cost terms of re-plans."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np

from ffsms_pin.checks import FloatArray, at_least_zero, one_each, positive, share
from ffsms_pin.opt.costs import Term
from ffsms_pin.opt.derivatives import Variables
from ffsms_pin.opt.search.spline import Grid
from ffsms_pin.options import Angle, NotNegative, PerJointPositive, Positive, Share, Unit


@dataclass(frozen=True, eq=False)
class ReplanOptions:
    """The options of the receding horizon.

    Raises
    ------
    InvalidValue
        If a value is out of range. `opt.Replanning` checks the number of values of `jerk`.
    """

    period: Annotated[Positive, Unit("s")] = 0.1
    """The time between two re-plans of the rest of the motion, at most a tenth of the remaining time and at
    least a step. Late re-plans are more frequent, so that a base drift of centimetres per second causes only
    a small error."""
    arrived_miss: float = 2e-3
    """The largest position error [m] of a plan that arrives. The default is a tenth of the paper's r_th, and
    twice the default tolerance of goals."""
    search_again: float = 1.0
    """The least time [s] between two searches, or a quarter of the remaining time if that is longer. A search
    is made if the rest of a plan does not arrive or violates a limit. For goals other than an `opt.Meet`, it
    is also the least time from the last plan that arrives within the limits to a search. After the failure of
    a joint, a search may follow at once."""
    dead_band: Annotated[NotNegative | None, Unit("m", "from the sensors")] = None
    """The distance from a fixed goal within which an arm at rest stays at rest after the deadline; a moving
    arm comes to rest within a third of it. Default: three times the noise of the measured end-effector
    position, at least 0.1 mm and at most 1 mm; 0 with perfect sensors."""
    settle: float = 0.1
    """The time [s] for the correction of a remaining error after the deadline with imperfect sensors. With a
    limit on the jerk, five times this time is used, also with perfect sensors."""
    jerk: Annotated[PerJointPositive | None, Angle("rad/s³ or m/s³", "none")] = None
    """The limit on the jerk of the command, for each joint. The joint limits have priority."""
    rate_reserve: Annotated[Share | None, Unit("", "0.05 for a client, else 0")] = None
    """The share of the joint rate limits that re-plans leave for corrections by steps and by the control law.
    Default: 0.05 for an `opt.Meet`, because corrections exceed planned rates by up to this share after
    changes of the client's estimate; otherwise zero, because a fastest plan may require the full limits."""
    # The grid of the spline that changes a plan. More intervals near the deadline would allow fast, late
    # changes.
    grid: ClassVar[Grid] = Grid(16, 2, 3)

    def __post_init__(self) -> None:
        positive("period", self.period, "s")
        for name in ("arrived_miss", "search_again", "settle"):
            at_least_zero(name, getattr(self, name))
        at_least_zero("dead_band", self.band(None), "m")
        if self.jerk is not None:
            one_each("jerk", self.jerk, np.size(self.jerk), "rad/s^3 or m/s^3")
        if self.rate_reserve is not None:
            share("rate_reserve", self.rate_reserve)

    def band(self, noise: float | None) -> float:
        """Return the dead band [m] for sensors with a position noise [m]; None: perfect sensors."""
        if self.dead_band is not None:
            return self.dead_band
        return 0.0 if noise is None else min(max(3.0 * noise, 1e-4), 1e-3)

    def rate_share(self, meets: bool) -> float:
        """Return the share of the joint rate limits that re-plans use; `meets` is True for an `opt.Meet`."""
        default = 0.05 if meets else 0.0
        return 1.0 - (default if self.rate_reserve is None else self.rate_reserve)

    def rests(self, distance: float, noise: float | None, rested: bool) -> bool:
        """Return whether an arm rests at a `distance` [m] after the deadline.

        Because of hysteresis, the result depends on `rested`, the result of the last step.
        """
        return distance < self.band(noise) / (1.0 if rested else 3.0)


@dataclass(frozen=True, eq=False)
class Nearby(Term):
    """The deviation of joint accelerations from those (n, 1, K) of the last plan that was searched or given.

    With the default `weight` [s^3/rad^2] a re-plan corrects errors without fast, late changes.
    """

    accelerations: FloatArray
    weight: float = 1e-2
    name = "nearby"

    def residual(self, m: Variables) -> Any:
        """Return the weighted deviation of the accelerations."""
        return self.weight**0.5 * (m.accelerations - self.accelerations)


@dataclass(frozen=True)
class Approach(Term):
    """The speed at which the distance to a fixed goal increases.

    Near a singular configuration, a detour that rotates the base may reduce the error by micrometres, which
    is less than the errors of the model. The unit of `weight` is s/m^2.
    """

    weight: float = 100.0
    name = "approach"

    def residual(self, m: Variables) -> Any:
        """Return the weighted speed at which the distance increases, zero if the distance decreases."""
        displacement = m.goal - m.tip
        # Below a distance of 1 mm the direction to the goal depends on noise, so the residual is reduced.
        growth = -displacement.dot(m.velocity) / displacement.norm(1e-3)
        return np.sqrt(self.weight) * np.maximum(growth, 0.0)
