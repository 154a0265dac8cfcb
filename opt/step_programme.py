"""The programme of one step, written from what the step is about into arrays that are used again.

It is said of joint rates rather than of alpha (docs/convex-step.md): V turns one into the other, so that the
solution is the same, and V is left with the box |alpha_i| <= 1 alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.base_rows import SLACK
from ffsms_pin.opt.bounded import BoundedProgramme, unbounded
from ffsms_pin.opt.clearance_rows import Rows
from ffsms_pin.opt.cone import Triple
from ffsms_pin.opt.momentum_drift import Drift
from ffsms_pin.opt.rate_bounds import UNBOUNDED
from ffsms_pin.opt.step_kinetics import StepKinetics
from ffsms_pin.opt.step_qp import StepProblem, StepSolver

__all__ = ["StepProgramme", "StepWeights"]


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
    """A `StepProblem` in the joint rates that is filled again and again, and its solver.

    Parameters
    ----------
    n : int
        Number of joints.
    points, base : int
        Numbers of clearances, and of rows for the base's motion.
    weights : StepWeights
    plain_effort : bool
        Whether the price of redundant motion is |alpha|^2; otherwise `price` adds it.

    Attributes
    ----------
    solver : StepSolver
        Of all rows.
    within : BoundedProgramme
        Of the bounds on the joint rates alone.
    lower, upper : ndarray, shape (n,)
        Bounds on the joint rates [rad/s].
    """

    def __init__(self, n: int, points: int, base: int, weights: StepWeights, plain_effort: bool) -> None:
        m, w = points, weights
        self._n, self._weights = n, weights
        self.solver, self.within = StepSolver(n + 2, n + m + base), BoundedProgramme(n + 1)
        self._problem = p = self.solver.problem
        p.C[n : n + m, n + 1], p.C[n + m :, n + 1] = 1.0, SLACK
        p.l[:], p.u[:] = -UNBOUNDED, UNBOUNDED
        p.l[:n], p.u[:n], p.upper[n:] = -1.0, 1.0, UNBOUNDED
        # The linear term with its sign turned round: where the objective pulls.
        self._pull = np.zeros(n + 2)
        self._pull[n + 1] = -w.clearance
        # Views, made once.
        self.lower, self.upper = p.lower[:n], p.upper[:n]
        self._box_lower, self._box_upper, self._widened = p.l[:n], p.u[:n], False
        self._pull_rates, self._H_rates = self._pull[:n], p.H[:n, :n]
        self._pull_free, self._H_free = self._pull[: n + 1], p.H[: n + 1, : n + 1]
        self._C_box, self._C_points, self._C_base = p.C[:n, :n], p.C[n : n + m, :n], p.C[n + m :, :n]
        self._l_points, self._l_base = p.l[n : n + m], p.l[n + m :]
        # The direction's term of the objective is w_direction |S x|^2; the others make a diagonal.
        self._S = np.zeros((3, n + 2))
        self._S_rates, self._S_turned = self._S[:, :n], self._S.T
        redundant = w.change + w.effort if plain_effort else w.change
        self._diagonal = np.diag([*([redundant] * n), w.speed, w.clearance])
        # As an array: numpy takes twice as long to read a plain number.
        self._change = np.array(w.change)

    def reset(self) -> None:
        """Forget which limits were reached."""
        self.within.forget()
        self.solver.reset()

    def aim(self, kinetics: StepKinetics, rates: FloatArray, e: Triple, speed: float) -> None:
        """The objective: to move along `e` at `speed` [m/s], after `rates` (n,) in the last step."""
        n, S, H = self._n, self._S, self._problem.H
        self._S_rates[:] = kinetics.J_v
        S[0, n], S[1, n], S[2, n] = -e[0], -e[1], -e[2]
        self._S_turned.dot(S, H)
        if self._weights.direction != 1.0:
            H *= self._weights.direction
        np.add(H, self._diagonal, H)
        np.multiply(rates, self._change, self._pull_rates)
        self._pull[n] = self._weights.speed * speed

    def price(self, effort: FloatArray) -> None:
        """Add the price rates^T W rates of redundant motion to the objective, W (n, n)."""
        self._H_rates += self._weights.effort * effort

    def drift(self, kinetics: StepKinetics, e: Triple, drift: Drift) -> None:
        """Add to the objective that the end effector also moves by itself."""
        pull = self._weights.direction * drift.tip_velocity
        self._pull_rates -= pull @ kinetics.J_v
        self._pull[self._n] += float(np.dot(e, pull))

    def turn(self, kinetics: StepKinetics, spin: FloatArray) -> None:
        """Add the orientation's term to the objective: the joints are to turn the end effector by `spin`."""
        turning = self._weights.orientation * kinetics.J_w.T
        self._H_rates += turning @ kinetics.J_w
        self._pull_rates += turning @ spin

    def prefer(self, rates: FloatArray) -> None:
        """Replace the objective by |rates - wanted rates|^2 and the price of the slack."""
        n = self._n
        self._H_free[:] = np.eye(n + 1)
        self._pull_rates[:], self._pull[n] = rates, 0.0

    def free(self) -> FloatArray | None:
        """Rates and speed (n + 1,) of least cost without limits. With no row to keep there is no slack."""
        return unbounded(self._H_free, self._pull_free)

    def bounded(self, lower: list[float], upper: list[float]) -> FloatArray | None:
        """Those within bounds on the joint rates, and no other limits; None where they were not found."""
        return self.within.solve(self._H_free, self._pull_free, [*lower, 0.0], [*upper, UNBOUNDED])

    def bound(self, V: FloatArray, rates: FloatArray, lower: list[float], upper: list[float]) -> None:
        """The joint limits, and the box of alpha."""
        self.lower[:], self.upper[:] = lower, upper
        self._C_box[:] = V.T
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

    def keep_clear(self, rows: Rows | None) -> None:
        """The rows of the clearances, up to the slack; None where all rates within the bounds meet them."""
        if rows is None:
            self._l_points[:] = -UNBOUNDED
        else:
            self._C_points[:], self._l_points[:] = rows

    def hold_base(self, rows: FloatArray, least: FloatArray) -> None:
        """The rows of the base's limits: rows @ joint rates >= least, up to the slack."""
        self._C_base[:], self._l_base[:] = rows, least

    def solve(self, as_before: bool) -> tuple[FloatArray, bool]:
        """Joint rates (n,) of least cost within all limits, and whether they were found.

        `as_before` says to start from the rows that were active the last time; otherwise from the bounds.
        """
        np.negative(self._pull, self._problem.g)
        if not as_before:
            self.solver.suppose([0] * len(self._problem.l) + [*self.within.sides, -1])
        x, solved = self.solver.solve()
        return x[: self._n], solved

    def within_is_whole(self) -> bool:
        """Whether the last solution reached bounds on the joint rates alone: `bounded` then starts there."""
        sides, n = self.solver.sides, self._n
        if sides is None or any(sides[: -n - 2]) or sides[-1] == 0:
            return False
        self.within.sides = sides[-n - 2 : -1]
        return True

    def in_alpha(self, V: FloatArray) -> StepProblem:
        """A copy of the programme in alpha: the joint rates become rows, and the box of alpha bounds."""
        n, p = self._n, self._problem
        turn = np.eye(n + 2)
        turn[:n, :n] = V
        C, low, up = p.C @ turn, p.l.copy(), p.u.copy()
        lower, upper = p.lower.copy(), p.upper.copy()
        C[:n, :n], low[:n], up[:n] = V, self.lower, self.upper
        lower[:n], upper[:n] = self._box_lower, self._box_upper
        return StepProblem(turn.T @ p.H @ turn, -self._pull @ turn, C, low, up, lower, upper)
