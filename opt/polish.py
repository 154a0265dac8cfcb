"""The exact solution of a quadratic programme whose active rows are known, or thought to be.

ProxQP stops within a tolerance, and where it stops depends in the last digits on where its memory lies: the
same problem can give another last bit in the next run, and a march of a thousand steps makes that visible.
Solving the equations of the active rows once more removes both. And since they seldom change from one step to
the next, the last step's rows are tried first: a solution of their equations that meets all other rows, and
whose multipliers have the right signs, is the solution, and ProxQP need not be asked.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ffsms_pin import lapack
from ffsms_pin.checks import FloatArray

__all__ = ["ActiveRows"]


# Sets of rows whose index arrays are kept.
_KEPT = 64


class _Equations(NamedTuple):
    """Where the equations of one set of active rows are found, and room for them."""

    place: NDArray[np.intp]  # of each entry of the symmetric [[H, A^T], [A, 0]] in the flat matrix
    bound: NDArray[np.intp]  # of each entry of the right side in the vector
    left: FloatArray
    left_columns: FloatArray  # the same memory, in the order in which LAPACK reads it
    right: FloatArray
    gradient: FloatArray  # its first part
    signs: FloatArray  # of the multipliers: above zero at the upper side
    active: NDArray[np.intp]
    sides: NDArray[np.int8]
    equal: NDArray[np.bool_]


class ActiveRows:
    """Minimise 1/2 x^T H x + g^T x with some of the rows low <= A x <= up as equations.

    Parameters
    ----------
    n, rows : int
        Sizes of x and of A x.

    Attributes
    ----------
    matrix : ndarray, shape (n + rows, n)
        H, positive definite, above A; to be filled in place. A ends with the identity, for bounds on x.
    vector : ndarray, shape (n + 2 rows,)
        g, low, up; likewise.
    """

    def __init__(self, n: int, rows: int) -> None:
        self._n, self._rows = n, rows
        self.matrix = np.zeros((n + rows, n))
        self.matrix[-n:] = np.eye(n)
        self.vector = np.zeros(n + 2 * rows)
        self._flat, self._A = self.matrix.reshape(-1), self.matrix[n:]
        self._low, self._up = self.vector[n : n + rows], self.vector[n + rows :]
        self._met = np.empty((2, rows), dtype=bool)
        self._above, self._below = self._met
        # Where in `matrix` each entry of [[H, A^T], [A, 0]] is found, of all rows.
        self._places = np.full(
            (n + rows, n + rows), (n + rows - 1) * n
        )  # the zero in the identity's last row
        self._places[:, :n] = np.arange((n + rows) * n).reshape(n + rows, n)
        self._places[:n, n:] = self._places[n:, :n].T
        self._variables = np.arange(n)
        self._seen: dict[bytes, _Equations] = {}
        self.choose(np.zeros(rows, dtype=np.int8))

    @property
    def sides(self) -> NDArray[np.int8]:
        """Which rows are the equations, as `choose` takes them."""
        return self._equations.sides

    def choose(self, sides: NDArray[np.int8]) -> None:
        """Take as equations the rows whose entry in `sides` (rows,) is 1, at `up`, or -1, at `low`."""
        key = sides.tobytes()
        if key not in self._seen:
            if len(self._seen) == _KEPT:
                self._seen.clear()
            self._seen[key] = self._equations_of(sides)
        self._equations = self._seen[key]

    def _equations_of(self, sides: NDArray[np.int8]) -> _Equations:
        n, equal = self._n, sides != 0
        (active,) = equal.nonzero()
        chosen = np.concatenate((self._variables, active + n))
        place = self._places.take(chosen, 0).take(chosen, 1)
        signs = sides.take(active).astype(np.float64)
        bound = chosen  # from here on
        bound[n:][signs > 0.0] += self._rows
        size = len(chosen)
        left, right = np.empty((size, size)), np.empty(size)
        return _Equations(place, bound, left, left.T, right, right[:n], signs, active, sides, equal)

    def solve(self, blocks: int, singles: int) -> tuple[FloatArray, bool]:
        """The minimiser x (n,), and whether it is that of the whole programme; NaN where there is none.

        Where it is not, rows that it breaks become equations, and those whose multiplier has the wrong sign
        are let go: all at once for so many rounds, which may go round in circles, then one by one, the first
        of them in their order, which does not (block principal pivoting; J. J. Judice and F. M. Pires,
        Computers & Operations Research 21, 1994).
        """
        n = self._n
        for round_ in range(blocks + singles + 1):
            place, bound, left, left_columns, right, gradient, signs, active, sides, equal = self._equations
            self._flat.take(place, None, left, "clip")
            self.vector.take(bound, None, right, "clip")
            np.negative(gradient, gradient)
            _, _, solution, info = lapack.dgesv(left_columns, right, 1)
            if info != 0:
                return np.full(n, np.nan), False
            # Written so that a NaN, which a singular system can leave, does not meet a row.
            reached = self._A.dot(solution[:n])
            np.greater_equal(reached, self._low, self._above)
            np.less_equal(reached, self._up, self._below)
            np.logical_or(self._met, equal, self._met)
            pressing = solution[n:] * signs
            if np.count_nonzero(self._met) == self._met.size and min(pressing.tolist(), default=0.0) >= 0.0:
                return solution[:n], True
            better = sides.copy()
            better[active[pressing < 0.0]] = 0
            better[~self._above], better[~self._below] = -1, 1
            if round_ >= blocks:
                first = int(np.argmax(better != sides))
                better[:first], better[first + 1 :] = sides[:first], sides[first + 1 :]
            if round_ < blocks + singles:
                self.choose(better)
        return solution[:n], False
