"""Levenberg-Marquardt within the joint limits, for several motions side by side, in stages.

Successive halving: many motions for a few iterations, the best of them for more, on a finer spline.

References: J. Nocedal, S. J. Wright, "Numerical Optimization", 2nd ed., 2006, ch. 10; K. Jamieson, A.
Talwalkar, "Non-stochastic best arm identification and hyperparameter optimization", 2016.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.goals import Changed, Goal
from ffsms_pin.opt.goals.near import end_errors
from ffsms_pin.opt.horizon.control_qp import ControlQP
from ffsms_pin.opt.horizon.merit import Linearisation, Weights, linearise
from ffsms_pin.opt.horizon.spline import Grid, RateSpline, embedded, rate_spline
from ffsms_pin.opt.problem import ARRIVAL_SHARE, Problem
from ffsms_pin.opt.terms.term import REFERENCE_TIME
from ffsms_pin.opt.trajectory import Trajectory

__all__ = [
    "LAST_WEIGHTS",
    "Candidates",
    "Model",
    "arrival_error",
    "corrected_goal",
    "descend",
    "distinct_best",
    "follow",
    "prefer_limits",
    "take_down",
    "tighten",
]

_LACK = 0.5  # share of a limit's margin at which a motion has landed


@dataclass(frozen=True, eq=False)
class Model:
    """A problem on one spline, with the solver of its steps; `goal` is the problem's, or near it."""

    problem: Problem
    goal: Goal
    spline: RateSpline
    qp: ControlQP

    @classmethod
    def make(cls, problem: Problem, grid: Grid) -> Model:
        """The problem on a spline so fine."""
        moving = not problem.goal.place(problem.duration).rests
        spline = rate_spline(problem.steps, problem.dt, grid, moving)
        return cls(problem, problem.goal, spline, ControlQP(problem, spline))

    def linearise(self, p: FloatArray, weights: Weights, below: float | FloatArray = np.inf) -> Linearisation:
        """Motions of control points (S, M, n); see `merit.linearise`."""
        return linearise(self.problem, self.goal, self.spline, p, weights, below)

    @property
    def time(self) -> float:
        """Scale of times: 1 for a motion of 8 s."""
        return self.problem.duration / REFERENCE_TIME


@dataclass
class Candidates:
    """Motions under way: control points (S, M, n), their linearisations and dampings (S,).

    A damping is that of a motion of 8 s, like the weights.
    """

    p: FloatArray
    at: Linearisation
    damping: FloatArray

    @classmethod
    def start(
        cls, model: Model, p: FloatArray, weights: Weights, damping: float | FloatArray = 0.03
    ) -> Candidates:
        """Motions linearised under these weights; the default damping is that of stages after the first."""
        return cls(p.copy(), model.linearise(p, weights), np.broadcast_to(damping, len(p)).astype(np.float64))

    def take(self, index: Any) -> Candidates:
        """The motions at an index."""
        return Candidates(self.p[index], self.at.take(index), self.damping[index])

    def join(self, other: Candidates) -> Candidates:
        """These motions and then the others."""
        damping = np.concatenate([self.damping, other.damping])
        return Candidates(np.concatenate([self.p, other.p]), self.at.join(other.at), damping)


def descend(model: Model, motions: Candidates, weights: Weights, iterations: int) -> Candidates:
    """Iterate, all motions in step; those that stall drop out. Changes `motions` and returns it."""
    diagonal, live = np.arange(motions.p[0].size), np.arange(len(motions.p))
    for left in reversed(range(iterations)):
        hessian, gradient = motions.at.hessian[live], motions.at.gradient[live]
        damped = hessian.copy()
        damped[:, diagonal, diagonal] += model.time**3 * motions.damping[live, None]
        solved = zip(damped, gradient, motions.p[live], strict=True)
        steps = np.stack([model.qp.solve(H, g, p) for H, g, p in solved])
        flat = steps.reshape(gradient.shape)
        expected = -np.einsum("si,si->s", flat, 2.0 * gradient + (hessian @ flat[..., None])[..., 0])
        trial, below = motions.p[live] + steps, motions.at.merit[live]
        # What follows begins under other weights, or is the end: the last iteration needs no derivatives.
        new = model.linearise(trial, weights, below if left else -np.inf)
        gain = below - new.merit
        better = gain > 0.0
        if better.all() and len(live) == len(motions.p):
            motions.p, motions.at = trial, new
        else:
            motions.p[live[better]] = trial[better]
            motions.at.put(live[better], new.take(better))
        ratio = gain / np.maximum(expected, 1e-15)
        factor = np.where(~better, 6.0, np.where(ratio > 0.7, 0.2, np.where(ratio > 0.3, 0.5, 2.0)))
        damping = np.maximum(motions.damping[live] * factor, 1e-6)
        motions.damping[live] = damping
        # Motions drop out that gain less than a thousandth, or whose step fails even under so much damping.
        little = gain < 1e-3 * (new.merit + 1e-4 * model.time)
        live = live[~np.where(better, little, damping > 1e3)]
        if not live.size:
            break
    return motions


def _weights(end: float, fade_speed: float, fade_distance: float, tie_break: float = 10.0) -> Weights:
    return Weights(end, max(1e3, 0.1 * end), tie_break, fade_speed, fade_distance)


# The end's weight grows from stage to stage, by ten each: a stiff end from the start would hold motions on
# the wrong way round. The smoothing is taken back meanwhile.
LAST_WEIGHTS = _weights(1e5, 0.0, 0.0, 1.0)
# Iterations of those that go on, on the coarse spline and then on the fine one.
_LATER = (3, _weights(1e3, 0.03, 0.01)), (3, _weights(1e4, 0.03, 0.002)), (5, LAST_WEIGHTS)


def take_down(model: Model, p: FloatArray) -> Candidates:
    """A few iterations with starts (S, M, n), and a few more with the best of them."""
    first, then = _weights(1e2, 0.3, 0.03), _weights(1e2, 0.1, 0.03)
    motions = distinct_best(model, Candidates.start(model, p, first, 0.3), len(p))
    motions = distinct_best(model, descend(model, motions, first, 3), 6)
    return descend(model, Candidates.start(model, motions.p, then, motions.damping), then, 2)


def follow(
    coarse: Model, fine: Model, pool: Candidates, keep: tuple[int, int, int], repeats: int = 1
) -> Candidates:
    """From the pool of early motions to a few on the fine spline, the best first.

    `keep` go on: on the coarse spline, on the fine one, and there to the end, in `repeats` times the
    iterations.
    """
    model, motions = coarse, pool
    for k, (most, (iterations, weights)) in enumerate(zip(keep, _LATER, strict=True)):
        p = distinct_best(model, motions, most).p
        if k == 1:
            model, p = fine, embedded(coarse.spline, fine.spline, p, fine.problem.joint_rates)
        motions = Candidates.start(model, p, weights)
        motions = descend(model, motions, weights, repeats * iterations)
    return distinct_best(fine, motions, keep[-1])


def distinct_best(model: Model, motions: Candidates, keep: int) -> Candidates:
    """The `keep` best motions; of those whose joints stay within 0.05 rad or m of each other only the best.

    Beside the smoothed merit the true objective counts, and the square of the largest lack of a clearance, in
    margins beyond the first: a short way through a body weighs little, and a descent does not find out of it.
    """
    chosen: list[int] = []
    places = model.spline.travel.free @ motions.p
    beyond = np.maximum(motions.at.blocked_share - 1.0, 0.0)
    worth = motions.at.merit + 0.3 * motions.at.objective + beyond**2
    for i in np.argsort(worth, kind="stable"):
        if all(np.max(np.abs(places[i] - places[j])) > 0.05 for j in chosen):
            chosen.append(int(i))
        if len(chosen) == keep:
            break
    return motions.take(chosen)


def tighten(model: Model, motion: Candidates) -> Candidates:
    """Make goal and limits stiffer, up to five times, where the terms pull harder than they do."""
    weights = LAST_WEIGHTS
    for _ in range(5):
        at = motion.at
        if at.limit_share[0] <= _LACK and at.end_share[0] <= 0.8 and at.late_share[0] <= 0.975:
            break
        weights = weights.stiffer()
        motion = descend(model, Candidates.start(model, motion.p, weights, motion.damping), weights, 4)
    return motion


def prefer_limits(model: Model, motion: Candidates) -> Candidates:
    """Where limits and goal cannot both be had: within the limits, as near to the goal as they allow."""
    for softer in (1e-1, 1e-2, 1e-3, 1e-4):
        if motion.at.limit_share[0] <= _LACK:
            break
        weights = LAST_WEIGHTS._replace(end=softer * LAST_WEIGHTS.end, limits=10.0 * LAST_WEIGHTS.limits)
        motion = descend(model, Candidates.start(model, motion.p, weights), weights, 15)
    return motion


def arrival_error(goal: Goal, plan: Trajectory) -> float:
    """The largest error at the deadline [m, rad], and of velocities that the goal asks for [m/s, rad/s]."""
    last = float(plan.position_error[-1]), float(plan.orientation_error[-1])
    return float(end_errors(goal, *last, plan.contact_velocity, plan.duration).max())


def corrected_goal(problem: Problem, goal: Goal, plan: Trajectory) -> Goal | None:
    """The next goal, after a landing at `goal` gave this plan; None where the plan arrives.

    It is beside the one before by as much as the finished motion missed the true one, and has less reach
    where that motion ends at the goal but is too far from it in the last tenth.
    """
    within = arrival_error(problem.goal, plan) <= problem.goal.tolerance
    if plan.reached and within:
        return None
    place, q = problem.goal.place(problem.duration), plan.q[-1]
    missed = place.missed(place.seen(problem.sms.at(q).end_effector_pose, q))
    way, turn = missed.way.value[:, 0, 0], pin.exp3(missed.vector[:, 0, 0])
    last = plan.t >= ARRIVAL_SHARE * plan.duration - 1e-9
    late = max(
        float(plan.position_error[last].max()) / problem.goal.reach,
        float(plan.orientation_error[last].max()) / problem.goal.orientation_reach,
    )
    # What a corrected motion shall use of the reaches in the last tenth.
    nearer = 0.95 / late if late > 1.0 and within else 1.0
    reaches = {"reach": nearer * goal.reach, "orientation_reach": nearer * goal.orientation_reach}
    return Changed(goal, lambda place: place.moved(way, turn), **reaches)
