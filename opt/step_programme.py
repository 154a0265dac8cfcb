"""The programme of one step, written from what the step is about into arrays that are used again.

Everything is said of joint rates first; V turns it into alpha (docs/convex-step.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.base_rows import SLACK
from ffsms_pin.opt.cone import Triple
from ffsms_pin.opt.momentum_drift import Drift
from ffsms_pin.opt.rate_bounds import UNBOUNDED
from ffsms_pin.opt.step_kinetics import StepKinetics
from ffsms_pin.opt.step_qp import StepSolver

__all__ = ["CLOSING_RATE", "StepProgramme", "StepWeights"]

# [1/s] A clearance may shrink at most this fast relative to what is left of it: slow enough for the arm to
# brake (the paper's arm stops an end effector from 0.2 m/s within a second), fast enough to pass near.
CLOSING_RATE = 2.0
# [m] Kept beyond the asked clearance, so that it also holds between nodes and in spite of curvature.
CLEARANCE_MARGIN = 2e-3


@dataclass(frozen=True)
class StepWeights:
    """Weights of the step's objective. They rank the aims; the limits are rows, not weights.

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
        On the slack of the clearance rows [1/(m/s)], and on its square [1/(m/s)^2]: some fifty times what any
        other aim gains by giving way, so a row gives way only where it cannot be kept.
    """

    direction: float = 1.0
    speed: float = 1e-2
    orientation: float = 1e-2
    effort: float = 1e-6
    change: float = 1e-5
    clearance: float = 1.0


class StepProgramme:
    """A `StepProblem` that is filled again and again, and its solver.

    Parameters
    ----------
    n : int
        Number of joints.
    points, base : int
        Numbers of clearances, and of rows for the base's motion.
    clearance : float
        To be kept [m].
    weights : StepWeights
    plain_effort : bool
        Whether the price of redundant motion is |alpha|^2; otherwise `price` adds it.

    Attributes
    ----------
    solver : StepSolver
        Its `problem` is what is filled.
    lower, upper : ndarray, shape (n,)
        Bounds on the joint rates [rad/s].
    """

    def __init__(
        self, n: int, points: int, base: int, clearance: float, weights: StepWeights, plain_effort: bool
    ) -> None:
        m, w = points, weights
        self._n, self._weights = n, weights
        self.solver = StepSolver(n + 2, n + m + base)
        self.problem = p = self.solver.problem
        p.g[n + 1] = w.clearance
        p.C[n : n + m, n + 1], p.C[n + m :, n + 1] = 1.0, SLACK
        p.l[:], p.u[:] = -UNBOUNDED, UNBOUNDED
        p.lower[:n], p.upper[:n], p.upper[n:] = -1.0, 1.0, UNBOUNDED
        # Views, made once.
        self.lower, self.upper = p.l[:n], p.u[:n]
        self._box_lower, self._box_upper, self._widened = p.lower[:n], p.upper[:n], False
        self._g_rates, self._H_rates = p.g[:n], p.H[:n, :n]
        self._C_rates, self._C_points, self._C_base = p.C[:n, :n], p.C[n : n + m, :n], p.C[n + m :, :n]
        self._l_points, self._l_base = p.l[n : n + m], p.l[n + m :]
        # The direction's term of the objective is w_direction |S x|^2; the others make a diagonal.
        self._S = np.zeros((3, n + 2))
        self._S_rates = self._S[:, :n]
        redundant = w.change + w.effort if plain_effort else w.change
        self._diagonal = np.diag([*([redundant] * n), w.speed, w.clearance])
        # As arrays: numpy takes twice as long to read a plain number.
        self._minus_change = np.array(-w.change)
        self._closing_rate, self._kept = np.array(CLOSING_RATE), np.array(clearance + CLEARANCE_MARGIN)

    def aim(self, kinetics: StepKinetics, rates: FloatArray, e: Triple, speed: float) -> None:
        """The objective: to move along `e` at `speed` [m/s], after `rates` (n,) in the last step."""
        n, S, H, V = self._n, self._S, self.problem.H, kinetics.V
        self._S_rates[:] = kinetics.J_v.dot(V)
        S[0, n], S[1, n], S[2, n] = -e[0], -e[1], -e[2]
        S.T.dot(S, H)
        if self._weights.direction != 1.0:
            H *= self._weights.direction
        np.add(H, self._diagonal, H)
        rates.dot(V, self._g_rates)
        np.multiply(self._g_rates, self._minus_change, self._g_rates)
        self.problem.g[n] = -self._weights.speed * speed

    def price(self, kinetics: StepKinetics, effort: FloatArray) -> None:
        """Add the price rates^T W rates of redundant motion to the objective, W (n, n)."""
        self._H_rates += self._weights.effort * (kinetics.V.T @ effort @ kinetics.V)

    def drift(self, kinetics: StepKinetics, e: Triple, drift: Drift) -> None:
        """Add to the objective that the end effector also moves by itself."""
        pull = self._weights.direction * drift.tip_velocity
        self._g_rates += pull @ kinetics.J_v @ kinetics.V
        self.problem.g[self._n] -= float(np.dot(e, pull))

    def turn(self, kinetics: StepKinetics, spin: FloatArray) -> None:
        """Add the orientation's term to the objective: the joints are to turn the end effector by `spin`."""
        B = kinetics.J_w @ kinetics.V
        self._H_rates += self._weights.orientation * (B.T @ B)
        self._g_rates -= self._weights.orientation * (B.T @ spin)

    def prefer(self, kinetics: StepKinetics, rates: FloatArray) -> None:
        """Replace the objective by |V alpha - rates|^2 and the price of the slack."""
        n, p = self._n, self.problem
        p.H[: n + 1, : n + 1] = np.eye(n + 1)
        p.g[:n], p.g[n] = -(kinetics.V.T @ rates), 0.0

    def bound(self, V: FloatArray, rates: FloatArray, lower: list[float], upper: list[float]) -> None:
        """The rows of the joint limits, and the box of alpha."""
        self.lower[:], self.upper[:] = lower, upper
        self._C_rates[:] = V
        if rates.dot(rates) > 1.0:
            # V turns from step to step, and rates that were within the box |alpha_i| <= 1 may now be outside.
            # No more than halfway between holding them and braking is asked for: that can always be done.
            held, braking = np.clip(rates, self.lower, self.upper), np.clip(0.0, self.lower, self.upper)
            self._box_upper[:] = np.maximum(1.0, np.abs(V.T @ (0.5 * (held + braking))))
            self._box_lower[:] = -self._box_upper
            self._widened = True
        elif self._widened:
            self._box_lower[:], self._box_upper[:] = -1.0, 1.0
            self._widened = False

    def keep_clear(self, V: FloatArray, value: FloatArray, gradient: FloatArray) -> None:
        """The rows of the clearances (m,) [m], with gradients (m, n) by the joint rates."""
        self._C_points[:] = gradient.dot(V)
        np.subtract(self._kept, value, self._l_points)
        np.multiply(self._l_points, self._closing_rate, self._l_points)

    def hold_base(self, V: FloatArray, rows: FloatArray, least: FloatArray) -> None:
        """The rows of the base's limits: rows @ joint rates >= least, up to the slack."""
        self._C_base[:], self._l_base[:] = rows @ V, least
