"""One step of the paper's method after the other: a quadratic programme that is solved, or braking."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import FloatArray, number, one_of, positive, vector
from ffsms_pin.coupling import cosine
from ffsms_pin.errors import InvalidValue, numerical_errors
from ffsms_pin.opt.goals.goal import as_goal
from ffsms_pin.opt.limits.limit import Limit, prepared
from ffsms_pin.opt.parts.reading import checked_parts, objective_of, rows_of
from ffsms_pin.opt.parts.term import Term
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.step.programme import (
    Programme,
    StepProblem,
    StepSolver,
    StepWeights,
    WantedMotion,
    programme_of,
)
from ffsms_pin.opt.step.state import REFERENCES, StepState, braking, rate_bounds, stoppable
from ffsms_pin.opt.terms import ideal_cosine, step_cost
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system.base_reaction import MODES
from ffsms_pin.threads import OneThread


@dataclass(frozen=True, eq=False)
class Step:
    """The result of one step.

    Attributes
    ----------
    alpha, joint_rates : ndarray, shape (n,)
        The paper's scaling factors, and V alpha at the end of a step of constant acceleration [rad/s].
    cos_theta, entropy, cost : float
        Coupling assistance of these rates, H_norm, and the paper's summand, at the step's start.
    solved : bool
        False where the programme was not solved, so that the arm brakes within its limits.
    slack : float
        How far the limits that may give way did [m/s]; zero where all of them are kept.
    """

    alpha: FloatArray
    joint_rates: FloatArray
    cos_theta: float
    entropy: float
    cost: float
    solved: bool
    slack: float = 0.0


class Stepper:
    """The paper's step as a quadratic programme in alpha on ProxQP.

    The paper's cost is zero where the end effector moves on a cone about the way to the target. The step
    picks the direction e of that cone on the side it is on, and finds alpha and the speed s with J*_v V alpha
    = s e as nearly as the limits allow (docs/convex-step.md). Where that fails the arm brakes within its
    limits.

    `limits` give rows of the programme, `terms` may add to its objective (`Term.step_objective`); `reference`
    is one of `REFERENCES`; `momentum`, `mode` and `wheel_total` are as in `StepState`. It remembers the last
    step, and is for one thread; `like()` makes another. `side` (3,) is the side of the cone that the last
    step was on, zero before the first; `base_start` (7,) the root pose that turn and shift of the base count
    from, None: where it is at the next step; `deadline` that of the motion, in the time of obstacles that
    move [s], None: that begins with the next step. `dt` may be changed between steps.
    """

    def __init__(
        self,
        sms: SpaceManipulator,
        dt: float,
        kappa: float,
        limits: Sequence[Limit],
        terms: Sequence[Term] = (),
        weights: StepWeights | None = None,
        reference: str = "step",
        momentum: ArrayLike | None = None,
        mode: str = "floating",
        wheel_total: ArrayLike | None = None,
    ) -> None:
        self.sms = sms
        self.dt, self.kappa = positive("dt", dt, "s"), positive("kappa", kappa)
        self.terms, self.weights = tuple(terms), weights or StepWeights()
        self.reference = one_of("reference", reference, REFERENCES)
        self.momentum = None if momentum is None else vector("momentum", momentum, 6)
        self.mode = one_of("mode", mode, MODES)
        self.wheel_total: FloatArray | None = None
        if wheel_total is not None and np.size(wheel_total):
            self.wheel_total = vector("wheel_total", wheel_total, len(sms.wheels or ()), "N m s")
        self._given = tuple(limits)
        self.limits = tuple(prepared(limit, sms) for limit in limits)
        self._in_braking = [one for limit in self.limits if (one := limit.in_braking) is not None]
        self._bounded = any(limit.joint_bounds is not None for limit in self.limits)
        self._solver = StepSolver()
        words = "this Stepper is at work in another thread; give each thread one of its own: stepper.like()"
        self._alone = OneThread(words)
        self.reset()

    @classmethod
    def of(
        cls,
        problem: Problem,
        reference: str = "step",
        weights: StepWeights | None = None,
        *,
        limits: Sequence[Limit] | None = None,
        terms: Sequence[Term] | None = None,
    ) -> Stepper:
        """A stepper that takes the steps of a problem; with other limits or terms where they are given."""
        limits = problem.limits if limits is None else checked_parts("limits", limits, Limit)
        terms = problem.terms if terms is None else checked_parts("terms", terms, Term)
        given = problem.momentum, problem.mode, problem.wheel_total
        return Stepper(problem.sms, problem.dt, problem.kappa, limits, terms, weights, reference, *given)

    def like(self, sms: SpaceManipulator | None = None) -> Stepper:
        """A new stepper with the same settings, but for another robot where one is given."""
        parts = self.kappa, self._given, self.terms, self.weights, self.reference
        return Stepper(sms or self.sms, self.dt, *parts, self.momentum, self.mode, self.wheel_total)

    def reset(
        self,
        side: ArrayLike = (0.0, 0.0, 0.0),
        base_start: FloatArray | None = None,
        deadline: float | None = None,
    ) -> None:
        """Forget the last step; of `side` the part across the way counts, zero: as the end effector moves."""
        self.side, self.base_start, self.deadline = np.array(side, dtype=np.float64), base_start, deadline
        # Of the last solution: rates at its end, since V turns from step to step; s and slack; multipliers.
        self._last: tuple[FloatArray, FloatArray, FloatArray] | None = None

    @numerical_errors("the step of the planner")
    def step(self, q: ArrayLike, joint_rates: ArrayLike, target: Any, time_left: float) -> Step:
        """The next joint rates, from q (nq,) and the rates (n,) at the step's start [rad/s].

        `target` is a place (3,) of the end effector, a pinocchio.SE3, or a goal that stands still, inertial
        axes; `time_left` the time to the deadline [s].
        """
        return self.advance(*self._checked(q, joint_rates, target, time_left))

    @numerical_errors("the step of the planner")
    def build(self, q: ArrayLike, joint_rates: ArrayLike, target: Any, time_left: float) -> StepProblem:
        """The quadratic programme of a step, without solving it; arguments as for `step`."""
        with self._alone:
            return self._build(*self._checked(q, joint_rates, target, time_left))[2].problem()

    def advance(
        self,
        q: FloatArray,
        rates: FloatArray,
        target: FloatArray,
        time_left: float,
        rotation: FloatArray | None = None,
        prefer: FloatArray | None = None,
    ) -> Step:
        """`step` for arguments that are known to be right; `rotation` (3, 3) is the wanted attitude, if any.

        `prefer` (n,) are joint rates to come as near to as the limits allow, instead of to the target.
        """
        with self._alone:
            step, wanted, programme = self._build(q, rates, target, time_left, rotation, prefer)
            n, V = self.sms.n, step.V
            self.side, self.base_start = wanted.side, step.base_start
            self.deadline = step.time + step.time_left
            start = None
            if self._last is not None:  # the last solution, in the basis of this step
                last, more, z = self._last
                start = np.concatenate([last.dot(V), more]), z
            found, slack = self._solver.solve(programme, start), 0.0
            if found.solved:
                chosen, slack = self._within(step.bounds, V.dot(found.x[:n])), max(0.0, float(found.x[n + 1]))
                self._last = chosen, found.x[n:], found.z
                if self._in_braking:
                    slower = self._within(step.bounds, braking(step))
                    chosen = self._within(step.bounds, stoppable(self._in_braking, step, chosen, slower))
            else:
                chosen, self._last = self._within(step.bounds, braking(step)), None
            velocity = step.J_star.dot(chosen) + step.tip_drift
            cos_theta = cosine(velocity.tolist()[:3], wanted.towards.tolist())
            cost = step_cost(cos_theta, step.entropy, self.kappa)
            return Step(chosen.dot(V), chosen, cos_theta, step.entropy, cost, found.solved, slack)

    def _checked(
        self, q: ArrayLike, joint_rates: ArrayLike, target: Any, time_left: float
    ) -> tuple[FloatArray, FloatArray, FloatArray, float, FloatArray | None]:
        """Arguments as `advance` takes them."""
        time_left = number("time_left", time_left)
        q = self.sms.checked_configuration("q", q)
        rates = vector("joint_rates", joint_rates, self.sms.n, "rad/s")
        if isinstance(target, np.ndarray):  # the most common case, and several times quicker than by a goal
            return q, rates, vector("target", target, 3, "m"), time_left, None
        goal = as_goal(target, "target")
        if goal.moves:
            raise InvalidValue("target", target, "must stand still for a step: give its place of now")
        place = goal.place(time_left).aim(self.sms, q)
        return q, rates, place.position, time_left, place.rotation

    def _build(
        self,
        q: FloatArray,
        rates: FloatArray,
        target: FloatArray,
        time_left: float,
        rotation: FloatArray | None = None,
        prefer: FloatArray | None = None,
    ) -> tuple[StepState, WantedMotion, Programme]:
        time = 0.0 if self.deadline is None else max(0.0, self.deadline - time_left)
        given = self.momentum, self.base_start, time, self.mode, self.wheel_total
        step, weights = StepState(self.sms, q, rates, self.dt, time_left, *given), self.weights
        ideal = ideal_cosine(step.entropy, self.kappa) if self.reference == "step" else 1.0
        rows = [rows for limit in self.limits if (rows := rows_of(limit, step)) is not None]
        wanted, programme = programme_of(step, target, ideal, self.side, rotation, weights, rows)
        H, g, n, V = programme.H, programme.g, self.sms.n, step.V
        if prefer is not None:
            H[:], g[:] = np.eye(n + 2), 0.0
            H[n + 1, n + 1] = g[n + 1] = weights.clearance
            g[:n] = -prefer.dot(V)
            return step, wanted, programme
        shares = [share for term in self.terms if (share := objective_of(term, step)) is not None]
        price = REFERENCES[self.reference]
        if price is not None:  # instead of the identity
            shares.append((weights.effort * (price(step) - np.eye(n)), np.zeros(n)))
        for W, w in shares:
            H[:n, :n] += V.T.dot(W).dot(V)
            g[:n] -= w.dot(V)
        return step, wanted, programme

    def bounded(self, angles: FloatArray, joint_rates: FloatArray, wanted: FloatArray) -> FloatArray:
        """The wanted rates (n,) for the end of a step, within the joints' bounds where a limit keeps them."""
        return self._within(rate_bounds(angles, joint_rates, self.sms.limits, self.dt), wanted)

    def _within(self, bounds: tuple[FloatArray, FloatArray], rates: FloatArray) -> FloatArray:
        """Rates (n,) within bounds to the last bit, where a limit keeps them."""
        return np.minimum(np.maximum(rates, bounds[0]), bounds[1]) if self._bounded else rates
