"""The quadratic programme of one step, from its state, its objective and the rows of its limits.

Variables x = (alpha (n), s, slack): the paper's scaling factors, the end-effector speed along the wanted
direction, and how far limits give way. Minimise 1/2 x^T H x + g^T x subject to l <= C x <= u and
lower <= x <= upper. Terms and limits are stated in the joint rates u = V alpha, and turned here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.limits.limit import UNBOUNDED, Rows
from ffsms_pin.opt.step.reference import WantedMotion
from ffsms_pin.opt.step.state import StepState

__all__ = ["Programme", "StepProblem", "StepWeights", "nearest_to", "objective", "programme_of"]


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

    @cached_property
    def sizes(self) -> FloatArray:
        """Those that every step has: of direction, speed, effort, change and clearance."""
        return np.array([self.direction, self.speed, self.effort, self.change, self.clearance])


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


class Programme(NamedTuple):
    """The same as it is solved: the bounds on single variables are rows, after the others.

    ProxQP has bounds of its own, but takes no multipliers of theirs to start from.

    Attributes
    ----------
    H, g : ndarray, shape (n + 2, n + 2), (n + 2,)
    A : ndarray, shape (m, n + 2)
    low, up : ndarray, shape (m,)
    least, greatest : ndarray, shape (n,)
        Bounds on the joint rates themselves, from rows that never give way [rad/s].
    """

    H: FloatArray
    g: FloatArray
    A: FloatArray
    low: FloatArray
    up: FloatArray
    least: FloatArray
    greatest: FloatArray

    @classmethod
    def of(cls, problem: StepProblem) -> Programme:
        """A problem that was looked at."""
        H, g, C, low, up, lower, upper = problem
        (bounded,) = (np.minimum(-lower, upper) < UNBOUNDED).nonzero()
        none = np.full(len(g) - 2, UNBOUNDED)
        rows = np.concatenate([C, np.eye(len(g))[bounded]])
        lows, ups = np.concatenate([low, lower[bounded]]), np.concatenate([up, upper[bounded]])
        return cls(H, g, rows, lows, ups, -none, none)

    def problem(self) -> StepProblem:
        """To look at."""
        lower, upper = np.full(len(self.g), -UNBOUNDED), np.full(len(self.g), UNBOUNDED)
        lower[-2:] = 0.0
        return StepProblem(self.H, self.g, self.A[:-2], self.low[:-2], self.up[:-2], lower, upper)


def programme_of(goal: tuple[FloatArray, FloatArray], V: FloatArray, rows: Sequence[Rows]) -> Programme:
    """The programme of an objective (H, g) with the rows of limits, then s >= 0 and slack >= 0.

    A row lower <= G u <= upper becomes lower <= G V alpha <= upper. Where it gives way, a side becomes a row
    of its own, G V alpha + give slack >= lower or G V alpha - give slack <= upper.

    Parameters
    ----------
    goal : (H, g)
    V : ndarray, shape (n, n)
        Right singular vectors of C_bm: u = V alpha.
    rows : sequence of Rows
    """
    return Programme(*goal, *kernel.stacked_rows(V, rows))


def objective(
    step: StepState,
    wanted: WantedMotion,
    weights: StepWeights,
    effort: FloatArray | None = None,
    spin: FloatArray | None = None,
    terms: Sequence[tuple[FloatArray, FloatArray]] = (),
) -> tuple[FloatArray, FloatArray]:
    """What a step should come to: H and g of 1/2 x^T H x + g^T x.

    Parameters
    ----------
    step : StepState
    wanted : WantedMotion
    weights : StepWeights
    effort : ndarray, shape (n, n), optional
        Price of the redundant motion, u^T effort u. Default: the identity.
    spin : ndarray, shape (3,), optional
        Wanted angular velocity of the end effector, inertial axes [rad/s].
    terms : sequence of (W (n, n), w (n,))
        More terms u^T W u / 2 - w^T u.
    """
    n, V, w, J_v = step.V.shape[0], step.V, weights, step.J_star[:3]
    motion = wanted.direction, wanted.speed
    H, g = kernel.objective(J_v, V, step.rates, step.tip_drift, *motion, w.sizes, effort is None)
    added = list(terms)
    if effort is not None:
        added.append((w.effort * effort, np.zeros(n)))
    if spin is not None:
        J_w = step.J_star[3:]
        added.append((w.orientation * J_w.T.dot(J_w), w.orientation * (spin - step.tip_drift[3:]).dot(J_w)))
    for matrix, vector in added:
        H[:n, :n] += V.T.dot(matrix).dot(V)
        g[:n] -= vector.dot(V)
    return H, g


def nearest_to(rates: FloatArray, V: FloatArray, weights: StepWeights) -> tuple[FloatArray, FloatArray]:
    """H and g of joint rates as near as possible to given ones (n,), whatever the end effector does."""
    n = rates.size
    H, g = np.eye(n + 2), np.zeros(n + 2)
    H[n + 1, n + 1] = g[n + 1] = weights.clearance
    g[:n] = -rates.dot(V)
    return H, g
