"""Groups of starts of a search: how many, how far they are followed, and when a search is content."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

__all__ = ["QUICK", "START_GROUPS", "StartGroup"]


class StartGroup(NamedTuple):
    """A group of starts, and how far they are followed.

    Attributes
    ----------
    near, far : int
        New joint goals: from postures near the start, and from the whole range of the joints.
    marches : bool
        Whether coarse marches of the paper's step are starts as well.
    keep : tuple of int
        Motions that are followed: on the coarse spline, on the fine one, and there to the end.
    repeats : int
        How many times the usual iterations these make: those whose end is hard to meet need more.
    free_cost, kappa_cost : float
        A plan as cheap as free_cost + kappa_cost (log 2 / kappa)^2 ends the search [s, for a motion of 8 s].
        C~ exceeds max(0, cos(theta_a)) by up to log 2 / kappa, so that for a small kappa no motion that
        arrives is nearly free.
    """

    near: int
    far: int
    marches: bool
    keep: tuple[int, int, int]
    repeats: int
    free_cost: float
    kappa_cost: float

    def content(self, kappa: float) -> float:
        """The cost [s] that ends the search, of motions up to 8 s."""
        return self.free_cost + self.kappa_cost * (math.log(2.0) / kappa) ** 2


# An early motion says little of what it comes to in the end, so where the first plans are not nearly free,
# more are followed, and longer.
START_GROUPS = (
    StartGroup(3, 4, True, (3, 2, 1), 1, 3e-3, 0.2),
    StartGroup(4, 8, False, (6, 4, 2), 2, 0.03, 0.5),
    StartGroup(4, 20, False, (10, 6, 4), 4, np.inf, 0.0),
)
# For a plan at any cost.
QUICK = (StartGroup(4, 4, False, (1, 1, 1), 2, np.inf, 0.0),)
