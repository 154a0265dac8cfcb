"""The quadratic programme of one step, and its solution by ProxQP.

Variables x = (alpha (n), s, slack): the paper's scaling factors, the end-effector speed along the wanted
direction, and how far limits give way. Minimise 1/2 x^T H x + g^T x subject to l <= C x <= u and
lower <= x <= upper. Terms and limits are stated in the joint rates u = V alpha, and turned here.

Reference: A. Bambade, S. El-Kazdadi, A. Taylor, J. Carpentier, "ProxQP: yet another quadratic programming
solver for robotics and beyond", Robotics: Science and Systems 2022.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from proxsuite import proxqp

from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.limits.limit import UNBOUNDED, Rows
from ffsms_pin.opt.step.state import StepState


@dataclass(frozen=True)
class StepWeights:
    """Weights of the step's objective. They rank its parts; the limits are rows, not weights.

    Attributes
    ----------
    direction : float
        On |J*_v V alpha - s e|^2 [1/(m/s)^2]: keeping the direction, and with it the paper's cost at zero.
    speed : float
        On (s - s_ref)^2 [1/(m/s)^2]: where the arm is limited or near-singular, the speed gives way and the
        direction stays.
    orientation : float
        On |J*_w V alpha - omega_ref|^2 [1/(rad/s)^2]: turning must not bend the path.
    effort : float
        On |alpha|^2 [1/(rad/s)^2]: the least redundant motion. It slows the arrival by a thousandth.
    change : float
        On |V alpha - rates|^2 [1/(rad/s)^2]: no jumps of redundant motion between steps.
    clearance : float
        On the slack of the rows that may give way [1/(m/s)], and on its square [1/(m/s)^2]: some fifty times
        what any other part gains by it, so a row gives way only where it cannot be kept.
    """

    direction: float = 1.0
    speed: float = 1e-2
    orientation: float = 1e-2
    effort: float = 1e-6
    change: float = 1e-5
    clearance: float = 1.0

    @cached_property
    def table(self) -> FloatArray:
        """All of them (6,), in their order."""
        return np.array(astuple(self))


class StepProblem(NamedTuple):
    """The matrices of one step, to look at, to test, or to give to another solver.

    Attributes
    ----------
    H, g : ndarray, shape (n + 2, n + 2), (n + 2,)
    C, l, u : ndarray, shape (m, n + 2), (m,), (m,)
        The rows of all limits; of a row with two sides that may give way, one for each.
    lower, upper : ndarray, shape (n + 2,)
        Bounds on x: s >= 0 and slack >= 0.
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
        gaps = np.concatenate([self.l - rows, rows - self.u, self.lower - x, x - self.upper])
        return max(0.0, float(gaps.max()))


class Programme(NamedTuple):
    """The same as it is solved: the bounds are rows (m, n + 2) after the others, low <= A x <= up.

    ProxQP has bounds of its own, but takes no multipliers of theirs to start from.
    """

    H: FloatArray
    g: FloatArray
    A: FloatArray
    low: FloatArray
    up: FloatArray

    def problem(self) -> StepProblem:
        """To look at."""
        lower, upper = np.full(len(self.g), -UNBOUNDED), np.full(len(self.g), UNBOUNDED)
        lower[-2:] = 0.0
        return StepProblem(self.H, self.g, self.A[:-2], self.low[:-2], self.up[:-2], lower, upper)


class WantedMotion(NamedTuple):
    """How the end effector should move at the end of a step, inertial axes.

    `towards`, `direction` and `side` (3,) are unit vectors to the target, along which to move (the e of
    docs/convex-step.md), and across the way on the side of the cone, which the next step is to be given. The
    first two are zero on arrival. `spin` (3,) leads to the wanted attitude, if any [rad/s]; `speed` is s_ref.
    """

    towards: FloatArray
    direction: FloatArray
    side: FloatArray
    spin: FloatArray
    speed: float


def programme_of(
    step: StepState,
    target: FloatArray,
    cosine: float,
    side: FloatArray,
    rotation: FloatArray | None,
    weights: StepWeights,
    rows: Sequence[Rows],
) -> tuple[WantedMotion, Programme]:
    """The motion to a target (3,) [m], and an attitude (3, 3), at acos(cosine) to the way, and its programme.

    The part of `side` (3,) across the way is the side to move on; zero: as the end effector moves. A row
    lower <= G u <= upper becomes lower <= G V alpha <= upper; where it gives way, each side becomes a row of
    its own, G V alpha + give slack >= lower or G V alpha - give slack <= upper. Last come s and slack >= 0.
    """
    given = step.J_star, step.V, step.rates, step.tip_drift, step.sms.limits.acceleration
    when = cosine, step.time_left, step.dt
    found, goal, stacked = kernel.step_programme(
        target - step.tip, rotation, step.tip_rotation, *given, side, *when, weights.table, rows
    )
    wanted = WantedMotion(found[:3], found[3:6], found[6:9], found[9:12], float(found[12]))
    return wanted, Programme(goal[:-1], goal[-1], *stacked)


# The flattest part of the objective, redundant motion, has a curvature of 1e-5: a gradient within 1e-11
# places it to 1e-6 rad/s. A laxer tolerance leaves open in a few steps of a thousand which rows are active.
_TOLERANCE = 1e-11


def new_solver(variables: int, rows: int) -> Any:
    """ProxQP's dense solver for programmes of one size, bounds among the rows, with the step's settings."""
    dense = proxqp.dense
    qp = dense.QP(variables, 0, rows, dense_backend=dense.DenseBackend.PrimalDualLDLT)
    settings = qp.settings
    settings.eps_abs, settings.eps_rel = _TOLERANCE, 0.0
    # Far below that curvature: each iteration leaves about the share regularisation / curvature of the error.
    settings.default_rho = 1e-8
    # A few are usual. A programme that takes these many has failed; they end within milliseconds.
    settings.max_iter = settings.max_iter_in = 40
    settings.initial_guess = proxqp.InitialGuess.WARM_START
    return qp


class Solution(NamedTuple):
    """The solution x (n + 2,) of a programme, and multipliers z (m,), above zero at a row's upper side.

    `solved`: the solver reached its tolerance.
    """

    x: FloatArray
    z: FloatArray
    solved: bool


class StepSolver:
    """Solves programmes one after the other, with a solver of ProxQP's for each size; a copy starts anew."""

    def __init__(self) -> None:
        self._solvers: dict[tuple[int, int], Any] = {}
        self.iterations = 0

    def __reduce__(self) -> tuple[Any, ...]:
        return StepSolver, ()

    def solve(self, p: Programme, start: tuple[FloatArray, FloatArray] | None = None) -> Solution:
        """Solution of a programme, from that (x, z) of one like it; where that fails, from nothing.

        ProxQP stops within its tolerance, and where it stops depends in the last digits on where its memory
        lies: over a march of a thousand steps that shows. The equations of the rows that are active by its
        multipliers have no memory. Their solution is taken where it keeps all rows and its multipliers have
        the right signs: so it is the programme's.
        """
        size = p.A.shape
        if start is not None and (len(start[1]), len(start[0])) != size:
            start = None
        qp = self._solvers.get(size)
        if qp is None:
            qp = self._solvers[size] = new_solver(size[1], size[0])
            qp.init(H=p.H, g=p.g, C=p.A, l=p.low, u=p.up, compute_preconditioner=False)
        else:
            qp.update(H=p.H, g=p.g, C=p.A, l=p.low, u=p.up)
        x, z = (np.zeros(size[1]), np.zeros(size[0])) if start is None else start
        qp.solve(x, None, z)
        results, info = qp.results, qp.results.info
        self.iterations = int(info.iter)
        solved = info.status == proxqp.PROXQP_SOLVED
        if solved and (exact := kernel.refined(*p, results.z, _TOLERANCE)) is not None:
            return Solution(*exact, True)
        x, z = np.array(results.x), np.array(results.z)
        solved = solved and math.isfinite(x.dot(x))  # finite where all of x is
        if not solved:
            del self._solvers[size]  # the next programme has no use for what is left in it
        # From a start ProxQP may end with multipliers of rows that are not touched, and call it solved.
        return Solution(x, z, solved) if start is None else self.solve(p)
