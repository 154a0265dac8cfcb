"""The quadratic programme of one step: its variables, its matrices and its solver.

Variables x = (alpha (n), s, slack): the paper's scaling factors, the end-effector speed along the wanted
direction, and how far a clearance row gives way. Minimise 1/2 x^T H x + g^T x subject to l <= C x <= u and
lower <= x <= upper.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from proxsuite import proxqp

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.polish import polish

__all__ = ["StepProblem", "StepSolver"]

# The flattest part of the objective, redundant motion, has a curvature of 1e-5: a gradient within 1e-10
# places it to 1e-5 rad/s. A laxer tolerance shows as jerks of the joints; a stricter one meets rounding.
TOLERANCE = 1e-10
# A warm start needs a handful of iterations; a step that needs this many gets the fall-back instead.
MAX_ITERATIONS = 200


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


class StepSolver:
    """ProxQP's dense solver for problems of one size: created once, then updated and warm-started.

    Parameters
    ----------
    variables, rows : int
        Sizes of x and of C x.
    """

    def __init__(self, variables: int, rows: int) -> None:
        dense = proxqp.dense
        self._qp: Any = dense.QP(
            variables,
            0,
            rows,
            box_constraints=True,
            dense_backend=dense.DenseBackend.PrimalDualLDLT,
        )
        settings = self._qp.settings
        settings.eps_abs = TOLERANCE
        settings.eps_rel = 0.0
        settings.max_iter = MAX_ITERATIONS
        # Every step has a solution, and the test for the opposite is easily fooled where bounds move fast.
        settings.eps_primal_inf = settings.eps_dual_inf = 1e-16
        settings.initial_guess = proxqp.InitialGuess.WARM_START_WITH_PREVIOUS_RESULT
        self._fresh = True
        self._eye = np.eye(variables)

    def solve(self, problem: StepProblem) -> tuple[FloatArray, bool]:
        """Solution x, and whether the solver reached its tolerance."""
        p = problem
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
        if results.info.status != proxqp.PROXQP_SOLVED or not np.isfinite(x).all():
            self._fresh = True  # what it would warm-start from is not a solution
            return x, False
        z = (
            results.z
        )  # of the rows, then of the bounds; vanishing where inactive, above zero at the upper side
        active = np.flatnonzero(np.abs(z) > TOLERANCE)
        rows = np.concatenate([p.C, self._eye])[active]
        upper, lower = np.concatenate([p.u, p.upper])[active], np.concatenate([p.l, p.lower])[active]
        return polish(p.H, p.g, rows, np.where(z[active] > 0.0, upper, lower), x), True

    @property
    def iterations(self) -> int:
        """Iterations of the last solve."""
        return int(self._qp.results.info.iter)
