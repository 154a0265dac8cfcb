"""The merit of whole motions: the squares of all residuals, weighted, and their slopes by the control points.

Terms, goal and limits contribute residuals; this file only stacks them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, reduce
from typing import Any, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray, Indices
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.goals.goal import Goal
from ffsms_pin.opt.goals.near import arrivals
from ffsms_pin.opt.goals.place import beyond
from ffsms_pin.opt.horizon.control_qp import ControlQP
from ffsms_pin.opt.horizon.spline import Grid, RateSpline, rate_spline
from ffsms_pin.opt.motion.feature import Feature
from ffsms_pin.opt.motion.features import Features
from ffsms_pin.opt.motion.motions import EXACT, Motions, Smoothing, apply_rates
from ffsms_pin.opt.parts.reading import asked, residuals_of
from ffsms_pin.opt.parts.term import REFERENCE_TIME, time_scale
from ffsms_pin.opt.problem import Problem, given
from ffsms_pin.system.batch.stacks import dot


class Weights(NamedTuple):
    """Weights of the squares beside the terms' own, and the smoothing of the paper's cost.

    For a motion of 8 s of an arm one metre long, and fitted to the problem by its duration and the arm's
    length. `end` is of the goal's errors at the deadline [1/m^2], a tenth of it of what they exceed in the
    last tenth; `limits` of the residuals of limits, over time [1/s]; `tie_break` multiplies the weights of
    terms that smooth (`Term.smooths`); for `fade_speed` and `fade_distance`, in arm lengths, see `Smoothing`.
    With `firm` ends steps hold the end while they spare cost (`beyond`): otherwise most long ones fail there.
    """

    end: float
    limits: float
    tie_break: float = 1.0
    fade_speed: float = 0.0
    fade_distance: float = 0.0
    firm: bool = False

    def stiffer(self, factor: float = 10.0) -> Weights:
        """With a stiffer goal and stiffer limits."""
        return self._replace(end=factor * self.end, limits=factor * self.limits)


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

    @cached_property
    def damping(self) -> FloatArray:
        """What a damping of one adds to a Hessian (Mn, Mn): small rates, of a change small accelerations."""
        n, squares = self.problem.sms.n, np.eye(self.spline.size)
        if self.spline.changes:
            # With M rates over T, |p|^2 is M / T times their square's integral; of an arc that of the
            # accelerations is 10 / T^2 times that.
            squares = (
                0.1 * self.spline.size * self.problem.duration * self.spline.squared_acceleration[1:, 1:]
            )
        return np.asarray(self.time**3 * np.kron(squares, np.eye(n)))

    @property
    def time(self) -> float:
        """Scale of times: 1 for a motion of 8 s."""
        return self.problem.duration / REFERENCE_TIME


class Candidates(NamedTuple):
    """S motions under way: every array has S rows, so that rows can be taken, replaced and joined.

    `p` (S, M, n) are the control points, `damping` (S,) that of a motion of 8 s, like the weights. `merit`
    and `objective` (S,): the weighted sum of squares, and the terms alone, not smoothed and not eased.
    `gradient` (S, Mn) and `hessian` (S, Mn, Mn): half of the merit's, Gauss-Newton, zero where not asked for.
    The largest part of the goal at the deadline as a share of its tolerance (S,), and in the last tenth of
    its reach; the largest residual as a share of the limit's margin, of all limits and of those that block.
    """

    p: FloatArray
    damping: FloatArray
    merit: FloatArray
    objective: FloatArray
    gradient: FloatArray
    hessian: FloatArray
    end_share: FloatArray
    late_share: FloatArray
    limit_share: FloatArray
    blocked_share: FloatArray

    def take(self, index: Any) -> Candidates:
        """The motions at an index."""
        return Candidates(*(rows[index] for rows in self))

    def put(self, index: Any, other: Candidates) -> None:
        """Replace the motions at an index."""
        for rows, new in zip(self, other, strict=True):
            rows[index] = new

    def join(self, other: Candidates) -> Candidates:
        """These motions and then the others."""
        return Candidates(*(np.concatenate(both) for both in zip(self, other, strict=True)))


class Arrival(NamedTuple):
    """What a goal asks of S motions. A radian, a metre a second and a radian a second weigh like a metre."""

    end: list[Feature]  # at the deadline
    tail: list[Feature]  # in the last tenth
    end_share: FloatArray  # (S,) the largest error at the deadline, as a share of the tolerance
    late_share: FloatArray  # (S,) and in the last tenth, as a share of the reach


def arrival(goal: Goal, motions: Motions, firm: bool = False) -> Arrival:
    """Residuals of the way to the goal beyond what is near enough; `firm`: see `Weights`."""
    (end, tail), m = arrivals(goal), Features(motions)
    late, last = slice(int(motions.last_tenth[0]), None), slice(motions.last, None)
    places, place = goal.places(motions.times[late]), goal.place(motions.duration)
    missed = places.missed(m.frame("tip", places.on).during(late)).parts
    asked = end.among([x.during(slice(-1, None)) for x in missed])
    near = tail.among([x.during(slice(0, len(motions.last_tenth))) for x in missed])
    moving = []
    if place.velocity is not None:
        moving.append((m.velocity.during(last) - place.velocity, goal.tolerance))
    if place.spin is not None:
        moving.append((m.spin.during(last) - place.spin, goal.tolerance))
    firm = firm and not goal.exact  # into a narrow corridor ends give way first: the way in matters more
    ends = [beyond(x, end.share * most, firm) for x, most in asked] + [x for x, _ in moving]
    (way, reach), *turns = near  # of the way the distance counts alone
    tails: list[Any] = [np.maximum(way.norm() - tail.share * reach, 0.0)]
    tails += [beyond(x, tail.share * most) for x, most in turns]
    end_residuals, tail_residuals = ([x.at_once() for x in found] for found in (ends, tails))
    return Arrival(end_residuals, tail_residuals, _share([*asked, *moving]), _share(near))


def _share(asked: list[tuple[Feature, float]]) -> FloatArray:
    """The largest of vectors as a share of what is allowed of each (S,)."""
    return reduce(np.maximum, [np.sqrt(dot(x.value, x.value)).max(axis=1) / most for x, most in asked])


def motions_of(
    problem: Problem,
    spline: RateSpline,
    p: FloatArray,
    smoothing: Smoothing = EXACT,
    goal: Goal | None = None,
) -> Motions:
    """Motions with control points p (S, M, n) at the spline's instants; `goal` is the problem's, or near it.

    dR/dt = R [omega]x, with omega the sum of spin @ u and of what a total momentum adds, by Picard's
    iteration. How the latter changes with the control points is left out of the slopes; the values are exact.
    """
    stack, rates0 = problem.stack, problem.joint_rates
    # Joints first, and in memory too.
    joints, rates, accelerations = (
        p.transpose(2, 0, 1) @ one.free.T + one.given(rates0).T[:, None]
        for one in (spline.travel, spline.rates, spline.accelerations)
    )
    joints = problem.joints0[:, None, None] + joints
    arm = stack.evaluate(joints)
    momentum, start = problem.momentum, problem.com0
    turned = kernel.spline_attitudes(
        spline.quadrature,
        apply_rates(arm.spin, rates),
        arm.inverse,
        problem.rotation0,
        np.zeros(3) if momentum is None else momentum[3:],
    )
    R, own = turned[:9].reshape(3, 3, *rates.shape[1:]), turned[9:].reshape(3, *rates.shape[1:])
    return Motions(
        stack=stack,
        times=spline.times,
        weights=spline.weights,
        limit_weights=spline.limit_weights,
        last_tenth=spline.last_tenth,
        joints=joints,
        rates=rates,
        accelerations=accelerations,
        evaluated=arm,
        base_attitude=R,
        com=start[:, None] + problem.drift[:, None] * spline.times,
        drift=problem.drift,
        own_spin=own,
        smoothing=smoothing,
        lag=problem.dt,
        **given(problem, goal or problem.goal, spline.times),
    )


def linearise(
    model: Model,
    p: FloatArray,
    weights: Weights,
    damping: float | FloatArray = 0.03,
    below: float | FloatArray = np.inf,
) -> Candidates:
    """Motions with control points p (S, M, n): residuals, squared and linearised.

    The default damping is that of stages after the first. Motions whose merit is not below `below`, (S,) or
    one, get no derivatives.
    """
    problem, goal, count = model.problem, model.goal, len(p)
    length = problem.stack.length
    smoothing = Smoothing(weights.fade_speed, weights.fade_distance * length)
    motions = motions_of(problem, model.spline, p, smoothing, goal)
    over_time, limits_time, seen = motions.weights, motions.limit_weights, Features(motions)
    merit, objective, lack, blocked = np.zeros((4, count))
    weighted: list[Weighted] = []

    def add(residual: Feature, factor: float, times: FloatArray) -> FloatArray:
        square = residual.squares(times, count)
        np.add(merit, factor * square, out=merit)
        weighted.append(Weighted.of(residual, factor, times))
        return square

    for term in problem.terms:
        ease = weights.tie_break if term.smooths else 1.0
        squares = [add(one, ease, over_time) for one in residuals_of(term, seen)]
        smoothed = term.measures_cost and smoothing != EXACT
        objective += asked(term, "cost", seen) if smoothed else sum(squares, np.zeros(count))
    at_goal = arrival(goal, motions, weights.firm)
    end = weights.end * time_scale(motions) / length**2
    for ones, factor in ((at_goal.end, end), (at_goal.tail, 0.1 * end)):
        for residual in ones:
            add(residual, factor, over_time)
    for limit in problem.limits:
        for residual in residuals_of(limit, seen):
            add(residual, weights.limits, limits_time)
            largest = _largest(residual, limit.margin)
            np.maximum.at(lack, *largest)
            if limit.blocks:
                np.maximum.at(blocked, *largest)
    good = np.flatnonzero(merit < below)
    gradient, hessian = sums(model.spline, motions, good, weighted)
    shares = at_goal.end_share, at_goal.late_share, lack, blocked
    dampings = np.broadcast_to(damping, count).astype(np.float64)
    return Candidates(p.copy(), dampings, merit, objective, gradient, hessian, *shares)


def _largest(residual: Feature, margin: float) -> tuple[Indices, FloatArray]:
    """Motions, and the largest residual of each as a share of the margin."""
    motion, _ = residual.where or (None, None)
    value = np.abs(residual.value).reshape(-1, *residual.shape[-2:]).max(axis=0) / max(margin, 1e-12)
    return (np.arange(len(value)), value.max(axis=1)) if motion is None else (motion, value[0])


class Weighted(NamedTuple):
    """A residual, and the weights of its squares at its instants, (K,) or (V,)."""

    residual: Feature
    weight: FloatArray

    @classmethod
    def of(cls, residual: Feature, factor: float, over_time: FloatArray) -> Weighted:
        """One weight for all values, times the quadrature's where the square is integrated."""
        if not residual.over_time:
            return cls(residual, np.full(residual.shape[-1], factor))
        return cls(residual, factor * (over_time if residual.where is None else over_time[residual.where[1]]))


def sums(
    spline: RateSpline, motions: Motions, chosen: Indices, residuals: list[Weighted]
) -> tuple[FloatArray, FloatArray]:
    """Gradients (S, Mn) and Hessians (S, Mn, Mn) of half the weighted sums of squares; chosen motions alone.

    The control points come first, the joints last; what its own momentum turns the base is left out.
    """
    count, size = motions.count, spline.size * motions.stack.n
    gradient, hessian = np.zeros((count, size)), np.zeros((count, size, size))
    if not chosen.size:
        return gradient, hessian
    every, given = np.arange(len(motions.times)), []
    rows = [motions.joints, motions.rates, motions.base_attitude, motions.own_spin]
    if any("by_entropy" in one.residual.slopes for one in residuals):
        rows.append(motions.entropy_and_slope[1])
    for residual, weight in residuals:
        (motion, instants), by = residual.where or (None, slice(None)), residual.slopes
        given.append((every[instants], motion, weight, residual.value, by))
    arrays = np.concatenate([one.reshape(-1, *motions.joints.shape[1:]) for one in rows])
    tree = motions.stack.tree
    kernel.sums(tree, spline.maps, spline.quadrature, arrays, given, chosen, gradient, hessian)
    return gradient, hessian
