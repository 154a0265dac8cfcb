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
from ffsms_pin.opt.step.programme import Programme

__all__ = ["Solution", "StepSolver", "new_solver"]

# The flattest part of the objective, redundant motion, has a curvature of 1e-5: a gradient within 1e-11
# places it to 1e-6 rad/s. A laxer tolerance leaves it open in a few steps of a thousand which rows are
# active; a stricter one takes a few per cent more iterations for nothing.
TOLERANCE = 1e-11
# Far below that curvature: each iteration leaves about the share regularisation / curvature of the error.
REGULARISATION = 1e-8
# A few iterations are usual. A programme that takes these many has failed; they end within milliseconds.
MOST_ITERATIONS = 40
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
    exact : bool
        Whether it is the solution of the equations of the rows that are active, with the right signs.
    """

    x: FloatArray
    z: FloatArray
    solved: bool
    exact: bool


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
    settings.max_iter = settings.max_iter_in = MOST_ITERATIONS
    settings.initial_guess = proxqp.InitialGuess.WARM_START
    return qp


class StepSolver:
    """Solves programmes one after the other, each from a start where one is given.

    ProxQP's solver is made once for each number of rows. For one thread; a copy starts anew.

    Attributes
    ----------
    iterations : int
        Of the last call of ProxQP.
    """

    def __init__(self) -> None:
        self._solvers: dict[tuple[int, int], Any] = {}
        self.iterations = 0

    def __reduce__(self) -> tuple[Any, ...]:
        return StepSolver, ()

    def solve(self, p: Programme, start: tuple[FloatArray, FloatArray] | None = None) -> Solution:
        """Solution of a programme.

        Parameters
        ----------
        p : Programme
        start : (x, z), optional
            As in `Solution`, of a programme like this one. A start of another size is not used. Where the
            solver does not converge from it, it starts once more from nothing.
        """
        if start is not None and (len(start[0]), len(start[1])) == (len(p.g), len(p.low)):
            found = self._solve(p, *start)
            # From a start ProxQP may end with multipliers of rows that are not touched, and call it solved.
            if found.exact:
                return found
        return self._solve(p, np.zeros(len(p.g)), np.zeros(len(p.low)))

    def _solve(self, p: Programme, x: FloatArray, z: FloatArray) -> Solution:
        """ProxQP's solution, made exact: that of the equations of the rows that are active by multipliers.

        ProxQP stops within its tolerance, and where it stops depends in the last digits on where its memory
        lies: over a march of a thousand steps that shows. The equations have no memory. Their solution is
        taken where it keeps all rows and its multipliers have the right signs: so it is the programme's.
        """
        size = p.A.shape
        qp = self._solvers.get(size)
        if qp is None:
            qp = self._solvers[size] = new_solver(size[1], size[0])
            qp.init(H=p.H, g=p.g, C=p.A, l=p.low, u=p.up, compute_preconditioner=False)
        else:
            qp.update(H=p.H, g=p.g, C=p.A, l=p.low, u=p.up)
        qp.solve(x, None, z)
        results = qp.results
        info = results.info
        self.iterations = int(info.iter)
        if info.status == proxqp.PROXQP_SOLVED:
            exact = kernel.refined(p.H, p.g, p.A, p.low, p.up, results.z, TOLERANCE, _KEPT)
            if exact is not None:
                return Solution(*exact, True, True)
        x, z = np.array(results.x), np.array(results.z)
        # The square is finite where all of x is.
        solved = info.status == proxqp.PROXQP_SOLVED and math.isfinite(x.dot(x))
        if not solved:
            del self._solvers[size]  # the next programme has no use for what is left in it
        return Solution(x, z, solved, False)
