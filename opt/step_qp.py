"""The quadratic programme of one step: its variables, its matrices and its solver.

Variables x = (alpha (n), s, slack): the paper's scaling factors, or joint rates instead of them; the
end-effector speed along the wanted direction; and how far a clearance row gives way. Minimise
1/2 x^T H x + g^T x subject to l <= C x <= u and lower <= x <= upper.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from proxsuite import proxqp

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.polish import ActiveRows

__all__ = ["StepProblem", "StepSolver", "new_solver"]

# The flattest part of the objective, redundant motion, has a curvature of 1e-5: a gradient within 1e-10
# places it to 1e-5 rad/s. A laxer tolerance shows as jerks of the joints; a stricter one meets rounding.
TOLERANCE = 1e-10
# A dozen iterations are usual; a step that needs this many gets the fall-back instead.
MAX_ITERATIONS = 200
# Rounds of exchanging active rows before ProxQP is asked, and after it has answered, for rows that it could
# not tell to be active or not within its tolerance. One round takes a tenth of ProxQP's time.
_BLOCKS, _SINGLES = 2, 6
# A solution of its rows' equations further from its own [in the units of x] comes from the wrong rows.
_NEAR = 1e-5


class StepProblem(NamedTuple):
    """The matrices of one step, to look at, to test, or to give to another solver.

    Attributes
    ----------
    H : ndarray, shape (n + 2, n + 2)
    g : ndarray, shape (n + 2,)
    C : ndarray, shape (n + m, n + 2)
        Rows: joint rates V alpha, then clearances.
    l, u : ndarray, shape (n + m,)
    lower, upper : ndarray, shape (n + 2,)
        Bounds on x: |alpha_i| <= 1, s >= 0, slack >= 0.
    """

    H: FloatArray
    g: FloatArray
    C: FloatArray
    l: FloatArray  # noqa: E741 - the solver's own name
    u: FloatArray
    lower: FloatArray
    upper: FloatArray

    def value(self, x: FloatArray) -> float:
        """The objective at x."""
        return float(0.5 * x @ self.H @ x + self.g @ x)

    def violation(self, x: FloatArray) -> float:
        """The largest violation of a row or bound at x, zero where x is feasible."""
        rows = self.C @ x
        gaps = [self.l - rows, rows - self.u, self.lower - x, x - self.upper]
        return max(0.0, max(float(gap.max()) for gap in gaps if gap.size))


def new_solver(variables: int, rows: int) -> Any:
    """ProxQP's dense solver for problems of one size, with the step's settings.

    Parameters
    ----------
    variables, rows : int
        Sizes of x and of C x.
    """
    dense = proxqp.dense
    qp = dense.QP(variables, 0, rows, box_constraints=True, dense_backend=dense.DenseBackend.PrimalDualLDLT)
    settings = qp.settings
    settings.eps_abs = TOLERANCE
    settings.eps_rel = 0.0
    settings.max_iter = MAX_ITERATIONS
    # Every step has a solution, and the test for the opposite is easily fooled where bounds move fast.
    settings.eps_primal_inf = settings.eps_dual_inf = 1e-16
    # It is asked where the active rows change, and then its last result is of little use as a start: from it
    # some problems take thousands of iterations, from nothing a dozen.
    settings.initial_guess = proxqp.InitialGuess.NO_INITIAL_GUESS
    return qp


class StepSolver:
    """Solves problems of one size, one after the other, each from where the last one ended.

    The rows that were active in the last problem, or that are supposed to be (`suppose`), are tried first
    (`ActiveRows`); where they are not this problem's, ProxQP is asked.

    Parameters
    ----------
    variables, rows : int
        Sizes of x and of C x.

    Attributes
    ----------
    problem : StepProblem
        To be filled in place, which saves copies.
    asked : bool
        Whether the last solution took ProxQP.
    """

    def __init__(self, variables: int, rows: int) -> None:
        n, r = variables, rows
        self._active = ActiveRows(n, r + n)
        matrix, vector = self._active.matrix, self._active.vector
        low, up = vector[n : 2 * n + r], vector[2 * n + r :]
        self.problem = StepProblem(
            matrix[:n], vector[:n], matrix[n : n + r], low[:r], up[:r], low[r:], up[r:]
        )
        self.reset()

    def __reduce__(self) -> tuple[Any, ...]:
        # Copied one by one, arrays would no longer be views of each other: a copy makes its own.
        return StepSolver, (self.problem.g.size, len(self.problem.l))

    def reset(self) -> None:
        """Forget the last solution."""
        self._qp = new_solver(self.problem.g.size, len(self.problem.l))
        self._fresh, self._known, self.asked = True, False, False

    def suppose(self, sides: list[int]) -> None:
        """Say which rows and bounds (r + n,) may be active: 1 at the upper side, -1 at the lower one."""
        self._active.choose(np.array(sides, dtype=np.int8))
        self._known = True

    @property
    def sides(self) -> list[int] | None:
        """Which rows and bounds are active in the last solution, as for `suppose`; None if that is open."""
        sides: list[int] | None = self._active.sides.tolist() if self._known else None
        return sides

    def solve(self, problem: StepProblem | None = None) -> tuple[FloatArray, bool]:
        """Solution x of `problem`, default the solver's own, and whether the solver reached its tolerance."""
        if problem is not None and problem is not self.problem:
            for own, given in zip(self.problem, problem, strict=True):
                own[:] = given
        if self._known:
            x, right = self._active.solve(_BLOCKS, _SINGLES)
            if right:
                self.asked = False
                return x, True
        self.asked = True
        return self._ask()

    def _ask(self) -> tuple[FloatArray, bool]:
        """Solution by ProxQP."""
        p = self.problem
        if self._fresh:
            self._qp.init(
                H=p.H, g=p.g, C=p.C, l=p.l, u=p.u, l_box=p.lower, u_box=p.upper, compute_preconditioner=False
            )
            self._fresh = False
        else:
            self._qp.update(H=p.H, g=p.g, C=p.C, l=p.l, u=p.u, l_box=p.lower, u_box=p.upper)
        self._qp.solve()
        results = self._qp.results
        x = np.array(results.x)
        self._known = False
        if results.info.status != proxqp.PROXQP_SOLVED or not np.isfinite(x).all():
            self._fresh = True
            return x, False
        z = np.array(results.z)  # of the rows, then of the bounds; above zero at the upper side
        self._active.choose((z > TOLERANCE).astype(np.int8) - (z < -TOLERANCE).astype(np.int8))
        own, _ = self._active.solve(0, 0)
        exact, self._known = self._active.solve(_BLOCKS, _SINGLES)
        if self._known:
            return exact, True
        # Written so that a NaN is not near.
        return own if np.abs(own - x).max() < _NEAR else x, True

    @property
    def iterations(self) -> int:
        """Iterations of the last call of ProxQP."""
        return int(self._qp.results.info.iter)
