"""The quadratic programme of one step, written whole from its state, its objective and the rows of its limits.

Variables x = (alpha (n), s, slack): the paper's scaling factors, the end-effector speed along the wanted
direction, and how far limits give way. Minimise 1/2 x^T H x + g^T x subject to l <= C x <= u and
lower <= x <= upper. Objective and limits are stated in the joint rates u = V alpha, and turned here.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.limits.limit import UNBOUNDED, Rows
from ffsms_pin.opt.limits.step_state import StepState
from ffsms_pin.opt.step.direction import WantedMotion

__all__ = ["Objective", "StepProblem", "StepWeights", "build_step", "hard_bounds", "nearest_to", "objective"]


@dataclass(frozen=True)
class StepWeights:
    """Weights of the step's objective. They rank its parts; the limits are rows, not weights.

    Attributes
    ----------
    direction : float
        On |J*_v V alpha - s e|^2 [1/(m/s)^2]: keeping the direction, and with it the paper's cost at zero.
    speed : float
        On (s - s_ref)^2 [1/(m/s)^2]. Far below `direction`: where the arm is limited or near-singular, the
        speed gives way and the direction stays.
    orientation : float
        On |J*_w V alpha - omega_ref|^2 [1/(rad/s)^2], for targets with an orientation. As far below
        `direction` as `speed`: turning must not bend the path.
    effort : float
        On |alpha|^2 [1/(rad/s)^2]: the least motion where the arm is redundant. Small enough to slow the
        arrival by about one part in a thousand.
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


class StepProblem(NamedTuple):
    """The matrices of one step, to look at, to test, or to give to another solver.

    Attributes
    ----------
    H : ndarray, shape (n + 2, n + 2)
    g : ndarray, shape (n + 2,)
    C : ndarray, shape (m, n + 2)
        The rows of all limits, one after the other; of a row with two sides that may give way, one for each.
    l, u : ndarray, shape (m,)
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


class Objective(NamedTuple):
    """The objective 1/2 y^T W y - w^T y in y = (u, s): joint rates at the step's end, and the speed.

    Attributes
    ----------
    W : ndarray, shape (n + 1, n + 1)
        Positive definite.
    w : ndarray, shape (n + 1,)
    """

    W: FloatArray
    w: FloatArray


def objective(
    step: StepState,
    wanted: WantedMotion,
    weights: StepWeights,
    effort: FloatArray,
    spin: FloatArray | None = None,
    terms: Iterable[tuple[FloatArray, FloatArray]] = (),
) -> Objective:
    """What a step should come to.

    Parameters
    ----------
    step : StepState
    wanted : WantedMotion
    weights : StepWeights
    effort : ndarray, shape (n, n)
        Price of the redundant motion, u^T effort u.
    spin : ndarray, shape (3,), optional
        Wanted angular velocity of the end effector, inertial axes [rad/s].
    terms : iterable of (W (n, n), w (n,))
        More terms u^T W u / 2 - w^T u.
    """
    n, drift = step.sms.n, step.tip_drift
    # |J*_v u + drift - s e|^2 = |S y + drift|^2.
    S = np.column_stack([step.J_star[:3], -wanted.direction])
    W = weights.direction * (S.T @ S)
    w = -weights.direction * (drift[:3] @ S)
    W[:n, :n] += weights.effort * effort
    W.flat[: n * (n + 2) : n + 2] += weights.change  # the diagonal of the joint rates
    w[:n] += weights.change * step.rates
    W[n, n] += weights.speed
    w[n] += weights.speed * wanted.speed
    if spin is not None:
        J_w = step.J_star[3:]
        W[:n, :n] += weights.orientation * (J_w.T @ J_w)
        w[:n] += weights.orientation * ((spin - drift[3:]) @ J_w)
    for matrix, vector in terms:
        W[:n, :n] += matrix
        w[:n] += vector
    return Objective(W, w)


def nearest_to(rates: FloatArray) -> Objective:
    """Joint rates as near as possible to given ones (n,), instead of a motion of the end effector."""
    return Objective(np.eye(rates.size + 1), np.append(rates, 0.0))


def build_step(V: FloatArray, goal: Objective, rows: Sequence[Rows], weights: StepWeights) -> StepProblem:
    """The programme of a step.

    A row lower <= G u <= upper becomes lower <= G V alpha <= upper. Where it gives way, a side becomes a row of
    its own, G V alpha + give slack >= lower or G V alpha - give slack <= upper.

    Parameters
    ----------
    V : ndarray, shape (n, n)
        Right singular vectors of C_bm: u = V alpha.
    goal : Objective
    rows : sequence of Rows
    weights : StepWeights
    """
    n = V.shape[0]
    turn = np.zeros((n + 1, n + 1))
    turn[:n, :n], turn[n, n] = V, 1.0
    H = np.zeros((n + 2, n + 2))
    H[: n + 1, : n + 1] = turn.T @ goal.W @ turn
    H[n + 1, n + 1] = weights.clearance
    g = np.append(-goal.w @ turn, weights.clearance)

    sided = [part for given in rows for part in _one_sided(given)]
    C = np.zeros((sum(len(part.lower) for part in sided), n + 2))
    if sided:
        C[:, :n] = np.concatenate([part.G for part in sided]) @ V
        C[:, n + 1] = np.repeat([part.give for part in sided], [len(part.lower) for part in sided])
    lower, upper = np.full(n + 2, -UNBOUNDED), np.full(n + 2, UNBOUNDED)
    lower[n:] = 0.0
    return StepProblem(
        H=H,
        g=g,
        C=C,
        l=np.concatenate([np.empty(0), *(part.lower for part in sided)]),
        u=np.concatenate([np.empty(0), *(part.upper for part in sided)]),
        lower=lower,
        upper=upper,
    )


def _one_sided(rows: Rows) -> list[Rows]:
    """Rows whose `give` is the slack's coefficient: those that give way have one side each."""
    if rows.give == 0.0:
        return [rows]
    parts, above, below = [], rows.upper < UNBOUNDED, rows.lower > -UNBOUNDED
    if below.any():
        parts.append(Rows(rows.G[below], rows.lower[below], np.full(below.sum(), UNBOUNDED), rows.give))
    if above.any():
        parts.append(Rows(rows.G[above], np.full(above.sum(), -UNBOUNDED), rows.upper[above], -rows.give))
    return parts


def hard_bounds(rows: Sequence[Rows], n: int) -> tuple[FloatArray, FloatArray]:
    """Bounds (n,) on the joint rates that rows state one by one (G = 1) and that never give way [rad/s]."""
    lower, upper, one = np.full(n, -UNBOUNDED), np.full(n, UNBOUNDED), np.eye(n)
    for given in rows:
        if given.give == 0.0 and np.array_equal(given.G, one):
            lower, upper = np.maximum(lower, given.lower), np.minimum(upper, given.upper)
    return lower, upper
