"""Goals made of another goal: what they have from it."""

from __future__ import annotations

from dataclasses import dataclass

from ffsms_pin.opt.goals.goal import Goal

__all__ = ["OfAnother"]


@dataclass(frozen=True, eq=False)
class OfAnother(Goal):
    """A goal seen in another way: tolerances, and whether it moves, is exact or coupled, are the other's.

    Attributes
    ----------
    goal : Goal
    """

    goal: Goal

    def __post_init__(self) -> None:
        for name in ("tolerance", "reach", "orientation_reach"):
            object.__setattr__(self, name, getattr(self.goal, name))

    @property
    def moves(self) -> bool:
        """Whether the other one does."""
        return self.goal.moves

    @property
    def exact(self) -> bool:
        """Whether the other one is."""
        return self.goal.exact

    @property
    def coupled(self) -> bool:
        """Whether the other one is."""
        return self.goal.coupled
