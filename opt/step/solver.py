"""ProxQP on the programmes of steps, one after the other.

Reference: A. Bambade, S. El-Kazdadi, A. Taylor, J. Carpentier, "ProxQP: yet another quadratic programming
solver for robotics and beyond", Robotics: Science and Systems 2022.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from proxsuite import proxqp

from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.step.programme import AllRows, Objective, StepProblem

__all__ = ["Solution", "StepSolver", "new_solver"]

# The flattest part of the objective, redundant motion, has a curvature of 1e-5: a gradient within 1e-11
# places it to 1e-6 rad/s. A laxer tolerance leaves it open in a few steps of a thousand which rows are
# active; a stricter one takes a few per cent more iterations for nothing.
TOLERANCE = 1e-11
# Far below that curvature: each iteration leaves about the share regularisation / curvature of the error.
REGULARISATION = 1e-8
# A few iterations are usual. A programme that takes these many has failed; they end within milliseconds.
OUTER_ITERATIONS, INNER_ITERATIONS = 40, 40
_KEPT = 1e-9  # [in the units of the rows] how exactly the refined solution keeps all rows


class Solution(NamedTuple):
    """The solution of a programme.

    Attributes
    ----------
    x : ndarray, shape (n + 2,)
    z : ndarray, shape (m + b,)
        Multipliers of the rows, then of the b variables that have bounds; above zero at the upper side.
    solved : bool
        Whether the solver reached its tolerance.
    """

    x: FloatArray
    z: FloatArray
    solved: bool


def new_solver(variables: int, rows: int) -> Any:
    """ProxQP's dense solver for programmes of one size, with the step's settings.

    Parameters
    ----------
    variables, rows : int
        Sizes of x, and of all rows with the bounds among them.
    """
    dense = proxqp.dense
    qp = dense.QP(variables, 0, rows, dense_backend=dense.DenseBackend.PrimalDualLDLT)
    settings = qp.settings
    settings.eps_abs, settings.eps_rel = TOLERANCE, 0.0
    settings.default_rho = REGULARISATION
    settings.max_iter, settings.max_iter_in = OUTER_ITERATIONS, INNER_ITERATIONS
    settings.initial_guess = proxqp.InitialGuess.WARM_START
    return qp


class StepSolver:
    """Solves programmes one after the other, each from a start where one is given.

    ProxQP's solver is made once for each number of rows. For one thread.

    Attributes
    ----------
    iterations : int
        Of the last call of ProxQP.
    cold : bool
        Whether the last solution was found from nothing, although a start was given.
    """

    def __init__(self) -> None:
        self._solvers: dict[tuple[int, int], Any] = {}
        self.iterations, self.cold = 0, False

    def solve(self, problem: StepProblem, start: tuple[FloatArray, FloatArray] | None = None) -> Solution:
        """Solution of a programme.

        Parameters
        ----------
        problem : StepProblem
        start : (x, z), optional
            As in `Solution`, of a programme like this one. A start of another size is not used. Where the
            solver does not converge from it, it starts once more from nothing.
        """
        return self.solve_rows(Objective(problem.H, problem.g), problem.all_rows(), start)

    def solve_rows(
        self, goal: Objective, rows: AllRows, start: tuple[FloatArray, FloatArray] | None = None
    ) -> Solution:
        """The same, of a programme whose rows are stacked already."""
        nothing = np.zeros(len(goal.g)), np.zeros(len(rows.low))
        if start is None or (start[0].shape, start[1].shape) != (nothing[0].shape, nothing[1].shape):
            start = nothing
        found = self._solve(goal, rows, start)
        exact = _refined(goal, rows, found)
        # From a start ProxQP may end with multipliers of rows that are not touched, and call it solved.
        self.cold = start is not nothing and exact is None
        if self.cold:
            found = self._solve(goal, rows, nothing)
            exact = _refined(goal, rows, found)
        return found if exact is None else exact

    def _solve(self, goal: Objective, rows: AllRows, start: tuple[FloatArray, FloatArray]) -> Solution:
        size = rows.A.shape
        qp = self._solvers.get(size)
        if qp is None:
            qp = self._solvers[size] = new_solver(size[1], size[0])
            qp.init(H=goal.H, g=goal.g, C=rows.A, l=rows.low, u=rows.up, compute_preconditioner=False)
        else:
            qp.update(H=goal.H, g=goal.g, C=rows.A, l=rows.low, u=rows.up)
        qp.solve(start[0], None, start[1])
        results = qp.results
        x, z = np.array(results.x), np.array(results.z)
        self.iterations = int(results.info.iter)
        # The square is finite where all of x is.
        solved = results.info.status == proxqp.PROXQP_SOLVED and math.isfinite(x.dot(x))
        if not solved:
            del self._solvers[size]  # the next programme has no use for what is left in it
        return Solution(x, z, solved)


def _refined(goal: Objective, rows: AllRows, found: Solution) -> Solution | None:
    """The exact solution of the equations of the rows that the multipliers say are active.

    ProxQP stops within its tolerance, and where it stops depends in the last digits on where its memory lies:
    over a march of a thousand steps that shows. The equations have no memory. Their solution is taken where
    it keeps all rows and its multipliers have the right signs, which makes it the programme's; else None.
    """
    if not found.solved:
        return None
    exact = kernel.refined(goal.H, goal.g, rows.A, rows.low, rows.up, found.z, TOLERANCE, _KEPT)
    return None if exact is None else Solution(*exact, True)
