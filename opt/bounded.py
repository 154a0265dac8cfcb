"""A quadratic programme with bounds on its variables and no other rows: what most steps come down to."""

from __future__ import annotations

import math

import numpy as np

from ffsms_pin import lapack
from ffsms_pin.checks import FloatArray

__all__ = ["BoundedProgramme", "unbounded"]

# Rounds for each variable. Ten in all are many; the bound only ends what rounding could make go on for ever.
_ROUNDS = 5


class BoundedProgramme:
    """Minimise 1/2 x^T H x - pull^T x with lower <= x <= upper, for one small H after the other.

    The bounds that were reached the last time are tried first. Variables at a bound are constants, the others
    solve their equations. From then on a primal active-set method: where their solution breaks bounds, x goes
    towards it as far as the first of these, which then is reached; where it breaks none, the bound that
    holds x back most against the objective's slope is left. The objective falls from round to round, so no
    set of bounds is seen twice (J. Nocedal and S. J. Wright, Numerical Optimization, 2006, section 16.5).
    The solution depends on the bounds that it reaches, not on how they were found.

    Parameters
    ----------
    n : int
        Number of variables.

    Attributes
    ----------
    sides : list of int
        Which bounds were reached the last time: -1 the lower, 1 the upper, 0 none.
    """

    def __init__(self, n: int) -> None:
        self._n = n
        self.forget()

    def forget(self) -> None:
        """Start from no bound."""
        self.sides = [0] * self._n

    def solve(
        self, H: FloatArray, pull: FloatArray, lower: list[float], upper: list[float]
    ) -> FloatArray | None:
        """The minimiser x (n,); None where it was not found.

        Parameters
        ----------
        H : ndarray, shape (n, n)
            Positive definite.
        pull : ndarray, shape (n,)
        lower, upper : list of float
        """
        x: list[float] | None = None  # where the method is, within the bounds
        for _ in range(_ROUNDS * self._n):
            found = self._at(H, pull, lower, upper)
            if found is None:
                return None
            wanted = found.tolist()
            broken = list(map(_broken, self.sides, wanted, lower, upper))
            if not any(broken):
                slope = (H.dot(found) - pull).tolist()
                wrong = [side * along for side, along in zip(self.sides, slope, strict=True)]
                # Written so that a NaN is never right.
                if all(size <= 0.0 for size in wrong):
                    return found
                x, self.sides = wanted, _with(self.sides, wrong.index(max(wrong)), 0)
            elif x is None:
                x = [min(max(value, low), up) for value, low, up in zip(wanted, lower, upper, strict=True)]
                self.sides = [side or new for side, new in zip(self.sides, broken, strict=True)]
            else:
                x, first = _towards(x, wanted, broken, lower, upper)
                self.sides = _with(self.sides, first, broken[first])
        return None

    def _at(
        self, H: FloatArray, pull: FloatArray, lower: list[float], upper: list[float]
    ) -> FloatArray | None:
        """The minimiser with the variables of `sides` at their bounds, and none for the others."""
        if not any(self.sides):
            return unbounded(H, pull)
        bounds = zip(self.sides, lower, upper, strict=True)
        x = np.array([0.0 if side == 0 else low if side < 0 else up for side, low, up in bounds])
        free = np.array([i for i, side in enumerate(self.sides) if side == 0], dtype=np.intp)
        if free.size:
            rows = H.take(free, 0)
            found = unbounded(rows.take(free, 1), pull.take(free) - rows.dot(x))
            if found is None:
                return None
            x[free] = found
        return x


def unbounded(H: FloatArray, pull: FloatArray) -> FloatArray | None:
    """The x with H x = pull; None where H is not positive definite."""
    x: FloatArray
    _, x, info = lapack.dposv(H, pull)
    return x if info == 0 else None


def _broken(side: int, x: float, lower: float, upper: float) -> int:
    """Which bound a variable breaks that is not held at one."""
    # Written so that a NaN breaks one.
    return 0 if side else -1 if not x >= lower else 1 if not x <= upper else 0


def _with(sides: list[int], i: int, side: int) -> list[int]:
    return [*sides[:i], side, *sides[i + 1 :]]


def _towards(
    x: list[float], wanted: list[float], broken: list[int], lower: list[float], upper: list[float]
) -> tuple[list[float], int]:
    """From x towards what is wanted up to the first bound on the way, and which that is."""
    share, first = math.inf, 0
    for i, side in enumerate(broken):
        if side:
            length = wanted[i] - x[i]
            # Without a way to go x is at its bound but for rounding.
            possible = ((upper[i] if side > 0 else lower[i]) - x[i]) / length if length else 0.0
            if possible < share:
                share, first = possible, i
    return [start + share * (end - start) for start, end in zip(x, wanted, strict=True)], first
