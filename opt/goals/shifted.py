"""A goal put aside, for solvers whose model errs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.goals.goal import Place
from ffsms_pin.opt.goals.of_another import OfAnother

__all__ = ["Shifted"]


@dataclass(frozen=True, eq=False)
class Shifted(OfAnother):
    """Another goal, put aside: what a solver aims at where its model errs by as much.

    Attributes
    ----------
    goal : Goal
    offset : ndarray, shape (3,)
        [m]
    turn : ndarray, shape (3, 3)
        Rotation, inertial axes.
    nearer : float
        What is asked of the last tenth, as a share of the other goal's reaches.
    """

    offset: FloatArray
    turn: FloatArray
    nearer: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("reach", "orientation_reach"):
            object.__setattr__(self, name, self.nearer * getattr(self.goal, name))

    def place(self, t: float) -> Place:
        """The other's place, shifted and turned."""
        place = self.goal.place(t)
        rotation = None if place.rotation is None else self.turn @ place.rotation
        return place._replace(position=place.position + self.offset, rotation=rotation)

    def positions(self, times: FloatArray) -> FloatArray:
        """The other's, shifted."""
        return self.goal.positions(times) + self.offset[:, None]

    def rotations(self, times: FloatArray) -> FloatArray | None:
        """The other's, turned."""
        found = self.goal.rotations(times)
        return found if found is None else np.einsum("xy,yzk->xzk", self.turn, found)
