"""A goal made of another one: with its places changed, or seen from a later time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.goals.goal import Goal
from ffsms_pin.opt.goals.place import Place

__all__ = ["Changed"]


@dataclass(frozen=True, eq=False)
class Changed(Goal):
    """Another goal with its places changed, or seen from a later time: what solvers aim at instead of it.

    Attributes
    ----------
    goal : Goal
        Whether it moves, is exact or coupled, and what it is at rest with, is said of this one too.
    change : callable, optional
        From a place of that goal, or a stack of them, to this one's.
    later : float
        From when on it is seen [s].
    tolerance, reach, orientation_reach : float, optional
        Default: the other's.
    """

    goal: Goal
    change: Callable[[Place], Place] | None = None
    later: float = 0.0
    tolerance: float = None  # type: ignore[assignment]  # the other's are put in their place
    reach: float = None  # type: ignore[assignment]
    orientation_reach: float = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        for name in ("moves", "exact", "coupled", "at_rest_with"):
            object.__setattr__(self, name, getattr(self.goal, name))
        for name in ("tolerance", "reach", "orientation_reach"):
            if getattr(self, name) is None:
                object.__setattr__(self, name, getattr(self.goal, name))

    def place(self, t: float) -> Place:
        """The other's place, `later` seconds later, changed."""
        return self._changed(self.goal.place(t + self.later))

    def places(self, times: FloatArray) -> Place:
        """Likewise."""
        return self._changed(self.goal.places(times + self.later))

    def approach(self, duration: float) -> list[tuple[float, Place]]:
        """The other's, as far as it still lies ahead."""
        ahead = [(t - self.later, place) for t, place in self.goal.approach(duration + self.later)]
        return [(t, self._changed(place)) for t, place in ahead if t > 0.0 or not self.later]

    def _changed(self, place: Place) -> Place:
        return place if self.change is None else self.change(place)
