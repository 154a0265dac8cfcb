"""The Levenberg-Marquardt method for several motions in parallel, within the joint limits.

The unknowns are the control points of a spline, and the residuals belong to terms, goal and limits. By
successive halving, many motions get a few iterations, and the best motions get more iterations on
a finer spline.

References: J. Nocedal, S. J. Wright, "Numerical Optimization", 2nd ed., 2006, ch. 10; K. Jamieson, A.
Talwalkar, "Non-stochastic best arm identification and hyperparameter optimization", 2016.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, reduce
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray, Indices
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.costs import REFERENCE_TIME, time_scale
from ffsms_pin.opt.derivatives import Variable, Variables
from ffsms_pin.opt.evaluation import evaluate, residuals_of
from ffsms_pin.opt.goals.goal import Changed, Goal, deadzone
from ffsms_pin.opt.goals.pose_constraints import arrivals, end_errors
from ffsms_pin.opt.problem import Problem, given
from ffsms_pin.opt.rollouts import ARRIVAL_SHARE, EXACT, Rollouts, Smoothing, apply_rates
from ffsms_pin.opt.search.control_qp import ControlQP
from ffsms_pin.opt.search.spline import Grid, RateSpline, embedded, rate_spline
from ffsms_pin.opt.trajectory import Trajectory
from ffsms_pin.system.batch.stacks import dot


class Weights(NamedTuple):
    """The weights of goal and limits, and the smoothing of the paper's cost.

    `end` is the weight of the goal's errors at the deadline, for a motion of 8 s and an arm of 1 m;
    `linearise` scales it by duration and arm length. The goal's errors in the last tenth of the time have a
    tenth of this weight. `limits` is the weight of the limits' residuals, integrated over time. `tie_break`
    multiplies the weights of terms with `Term.smooths`. For `fade_speed` and `fade_distance`, in arm lengths,
    see `Smoothing`. If `firm` is true, steps that reduce the cost keep the final pose nearly fixed (see
    `deadzone`), except for exact goals.
    """

    end: float
    limits: float
    tie_break: float = 1.0
    fade_speed: float = 0.0
    fade_distance: float = 0.0
    firm: bool = False

    def stiffer(self, factor: float = 10.0) -> Weights:
        """Return the weights with a stiffer goal and stiffer limits."""
        return self._replace(end=factor * self.end, limits=factor * self.limits)


@dataclass(frozen=True, eq=False)
class Model:
    """A problem on a spline, with the QP of descent steps.

    `goal` is the goal of the problem, or the corrected goal of `corrected_goal`.
    """

    problem: Problem
    goal: Goal
    spline: RateSpline
    qp: ControlQP

    @classmethod
    def make(cls, problem: Problem, grid: Grid, free_end: bool = False) -> Model:
        """Discretise the problem on a grid.

        The joints may move at the deadline if `free_end` is true or the goal has a velocity.
        """
        moving = not problem.goal.place(problem.duration).rests
        spline = rate_spline(problem.steps, problem.dt, grid, moving or free_end)
        return cls(problem, problem.goal, spline, ControlQP(problem, spline))

    @cached_property
    def damping(self) -> FloatArray:
        """The Hessian (Mn, Mn) of the damping of rates, or of accelerations if `spline.changes`."""
        n, squares = self.problem.sms.n, np.eye(self.spline.size)
        if self.spline.changes:
            # For M control points over the time T, |p|^2 is about M / T times the integral of squared rates.
            # For parabolic rates, zero at both ends, the integral of the squared accelerations is 10 / T^2
            # times the integral of the squared rates.
            squares = (
                0.1 * self.spline.size * self.problem.duration * self.spline.squared_acceleration[1:, 1:]
            )
        return np.asarray(self.time**3 * np.kron(squares, np.eye(n)))

    @property
    def time(self) -> float:
        """The duration divided by `REFERENCE_TIME`."""
        return self.problem.duration / REFERENCE_TIME


class Candidates(NamedTuple):
    """A stack of S candidate motions of one model; every array has S rows.

    `p` (S, M, n) are the control points, and `damping` (S,) are factors on `Model.damping`. `merit` (S,) is
    the weighted sum of squares of all residuals, and `objective` (S,) the sum of the terms without smoothing.
    `gradient` (S, Mn) and `hessian` (S, Mn, Mn) are half of the merit's gradient and of its Gauss-Newton
    Hessian, or zero if they were not computed. `end_share` (S,) is the largest error at the deadline divided
    by the tolerance, and `late_share` (S,) the largest error in the last tenth divided by the reach.
    `limit_share` (S,) is the largest residual of a limit divided by the limit's margin, and `blocked_share`
    (S,) the largest of these ratios among limits with `Limit.blocks`. A single finished candidate has a
    `plan`.
    """

    model: Model
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
    plan: Trajectory = None  # type: ignore[assignment]

    @property
    def rows(self) -> tuple[FloatArray, ...]:
        """The arrays in the order of the fields."""
        return self[1:-1]

    def take(self, index: Any) -> Candidates:
        """Return the motions at an index."""
        return Candidates(self.model, *(rows[index] for rows in self.rows))

    def put(self, index: Any, other: Candidates) -> None:
        """Replace the motions at an index."""
        for rows, new in zip(self.rows, other.rows, strict=True):
            rows[index] = new

    def join(self, other: Candidates) -> Candidates:
        """Return the concatenation of these motions and others."""
        joined: list[Any] = [np.concatenate(both) for both in zip(self.rows, other.rows, strict=True)]
        return Candidates(self.model, *joined)


class Arrival(NamedTuple):
    """The residuals of S motions at their goal; 1 rad, 1 m/s and 1 rad/s are weighted like 1 m."""

    end: list[Variable]  # at the deadline
    tail: list[Variable]  # in the last tenth of the time
    end_share: FloatArray  # (S,) the largest error at the deadline, as a share of the tolerance
    late_share: FloatArray  # (S,) the largest error in the last tenth of the time, as a share of the reach


def arrival(goal: Goal, motions: Rollouts, firm: bool = False) -> Arrival:
    """Return the residuals of motions at a goal; for `firm` see `Weights`.

    Pose errors have the residual zero within a share of the tolerance at the deadline, and within a share of
    the reach in the last tenth of the time (`PoseTolerance.share`). Velocity errors have no deadzone.
    """
    (end, tail), m = arrivals(goal), Variables(motions)
    late, last = slice(int(motions.last_tenth[0]), None), slice(motions.last, None)
    places, place = goal.places(motions.times[late]), goal.place(motions.duration)
    missed = places.pose_error(m.frame("tip", places.on).during(late)).parts
    at_end = end.among([x.during(slice(-1, None)) for x in missed])
    near = tail.among([x.during(slice(0, len(motions.last_tenth))) for x in missed])
    moving = []
    if place.velocity is not None:
        moving.append((m.velocity.during(last) - place.velocity, goal.tolerance))
    if place.angular_velocity is not None:
        moving.append((m.angular_velocity.during(last) - place.angular_velocity, goal.tolerance))
    firm = firm and not goal.exact  # at a client, a narrow approach has priority over a fixed final pose
    ends = [deadzone(x, end.share * most, firm) for x, most in at_end] + [x for x, _ in moving]
    (displacement, reach), *turns = near  # before the deadline the residual is the length of the displacement
    tails: list[Any] = [np.maximum(displacement.norm() - tail.share * reach, 0.0)]
    tails += [deadzone(x, tail.share * most) for x, most in turns]
    end_residuals, tail_residuals = ([x.at_once() for x in residuals] for residuals in (ends, tails))
    return Arrival(end_residuals, tail_residuals, _share([*at_end, *moving]), _share(near))


def _share(errors: list[tuple[Variable, float]]) -> FloatArray:
    """Return the largest ratio (S,) of error length to tolerance, over all errors and instants."""
    return reduce(np.maximum, [np.sqrt(dot(x.value, x.value)).max(axis=1) / most for x, most in errors])


def motions_of(
    problem: Problem,
    spline: RateSpline,
    p: FloatArray,
    smoothing: Smoothing = EXACT,
    goal: Goal | None = None,
) -> Rollouts:
    """Roll out control points p (S, M, n) at the spline's instants; `goal` replaces the problem's goal.

    The base's attitude R, with dR/dt = R [omega]x, is integrated by collocation at the spline's Gauss points.
    The angular velocity omega is spin @ u for the joint rates u, plus the contribution of the total momentum.
    """
    stack, rates0 = problem.stack, problem.joint_rates
    # The joints are the first axis, also in memory.
    joints, rates, accelerations = (
        p.transpose(2, 0, 1) @ mapping.free.T + mapping.given(rates0).T[:, None]
        for mapping in (spline.travel, spline.rates, spline.accelerations)
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
    R, drift = turned[:9].reshape(3, 3, *rates.shape[1:]), turned[9:].reshape(3, *rates.shape[1:])
    return Rollouts(
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
        angular_drift=drift,
        smoothing=smoothing,
        delay=problem.dt,
        **given(problem, goal or problem.goal, spline.times),
    )


def linearise(
    model: Model,
    p: FloatArray,
    weights: Weights,
    damping: float | FloatArray = 0.03,
    below: float | FloatArray = np.inf,
) -> Candidates:
    """Linearise the residuals of motions with control points p (S, M, n).

    `damping` is (S,) or scalar. Derivatives are computed only for motions whose merit is less than `below`,
    (S,) or scalar.
    """
    problem, goal, count = model.problem, model.goal, len(p)
    length = problem.stack.length
    smoothing = Smoothing(weights.fade_speed, weights.fade_distance * length)
    motions = motions_of(problem, model.spline, p, smoothing, goal)
    over_time, limits_time, variables = motions.weights, motions.limit_weights, Variables(motions)
    merit, objective, excess, blocked = np.zeros((4, count))
    weighted: list[Weighted] = []

    def add(residual: Variable, factor: float, times: FloatArray) -> FloatArray:
        square = residual.squares(times, count)
        np.add(merit, factor * square, out=merit)
        weighted.append(Weighted.of(residual, factor, times))
        return square

    for term in problem.terms:
        factor = weights.tie_break if term.smooths else 1.0
        squares = [add(residual, factor, over_time) for residual in residuals_of(term, variables)]
        smoothed = term.measures_cost and smoothing != EXACT
        objective += evaluate(term, "cost", variables) if smoothed else sum(squares, np.zeros(count))
    at_goal = arrival(goal, motions, weights.firm)
    end = weights.end * time_scale(motions) / length**2
    for residuals, factor in ((at_goal.end, end), (at_goal.tail, 0.1 * end)):
        for residual in residuals:
            add(residual, factor, over_time)
    for limit in problem.limits:
        extra_margin = problem.extra_margins.get(limit.name, 0.0)
        for residual in residuals_of(limit, variables.with_margin(extra_margin)):
            add(residual, weights.limits, limits_time)
            largest = _largest(residual, limit.margin)
            np.maximum.at(excess, *largest)
            if limit.blocks:
                np.maximum.at(blocked, *largest)
    good = np.flatnonzero(merit < below)
    gradient, hessian = gradients_and_hessians(model.spline, motions, good, weighted)
    shares = at_goal.end_share, at_goal.late_share, excess, blocked
    dampings = np.broadcast_to(damping, count).astype(np.float64)
    return Candidates(model, p.copy(), dampings, merit, objective, gradient, hessian, *shares)


def _largest(residual: Variable, margin: float) -> tuple[Indices, FloatArray]:
    """Return indices of motions, which may repeat, and their largest residuals divided by the margin."""
    motion, _ = residual.where or (None, None)
    value = np.abs(residual.value).reshape(-1, *residual.shape[-2:]).max(axis=0) / max(margin, 1e-12)
    return (np.arange(len(value)), value.max(axis=1)) if motion is None else (motion, value[0])


class Weighted(NamedTuple):
    """A residual with the weights of its squares: (K,) at all instants, or (V,) at the instants `where`."""

    residual: Variable
    weight: FloatArray

    @classmethod
    def of(cls, residual: Variable, factor: float, over_time: FloatArray) -> Weighted:
        """Return the residual with the weight `factor`, times quadrature weights if it is integrated."""
        if not residual.over_time:
            return cls(residual, np.full(residual.shape[-1], factor))
        return cls(residual, factor * (over_time if residual.where is None else over_time[residual.where[1]]))


def gradients_and_hessians(
    spline: RateSpline, motions: Rollouts, chosen: Indices, residuals: list[Weighted]
) -> tuple[FloatArray, FloatArray]:
    """Return gradients (S, Mn) and Gauss-Newton Hessians (S, Mn, Mn) of half the weighted sum of squares.

    Both are zero for motions whose index is not in `chosen`. Along the axis Mn the joints vary fastest.
    """
    count, size = motions.count, spline.size * motions.stack.n
    gradient, hessian = np.zeros((count, size)), np.zeros((count, size, size))
    if not chosen.size:
        return gradient, hessian
    every, residual_data = np.arange(len(motions.times)), []
    rows = [motions.joints, motions.rates, motions.base_attitude, motions.angular_drift]
    if any("by_entropy" in residual.residual.slopes for residual in residuals):
        rows.append(motions.entropy_and_slope[1])
    for residual, weight in residuals:
        (motion, instants), by = residual.where or (None, slice(None)), residual.slopes
        residual_data.append((every[instants], motion, weight, residual.value, by))
    arrays = np.concatenate([row.reshape(-1, *motions.joints.shape[1:]) for row in rows])
    tree = motions.stack.tree
    momentum = motions.angular_momentum
    tumbling = () if momentum is None else (momentum,)
    kernel.sums(
        tree, spline.maps, spline.quadrature, arrays, residual_data, chosen, gradient, hessian, *tumbling
    )
    return gradient, hessian


_SHORTER = 0.3  # length of the second trial step as a share of the full step, if the full step fails
_SATISFIED = 0.5  # largest residual of a satisfied limit in `tighten`, as a share of the limit's margin


def descend(motions: Candidates, weights: Weights, iterations: int) -> Candidates:
    """Apply Levenberg-Marquardt iterations to all motions in parallel, in place, and return the motions.

    A motion whose merit stalls gets no further iterations. The returned derivatives may be zero.
    """
    model, live, now = motions.model, np.arange(len(motions.p)), motions
    for left in reversed(range(iterations)):
        damped = now.hessian + now.damping[:, None, None] * model.damping
        solved = zip(damped, now.gradient, now.p, strict=True)
        steps = np.stack([model.qp.solve(H, g, p) for H, g, p in solved])
        flat = steps.reshape(now.gradient.shape)
        expected = -np.einsum("si,si->s", flat, 2.0 * now.gradient + (now.hessian @ flat[..., None])[..., 0])
        # The last iteration computes no derivatives, because the caller linearises again or is finished.
        new = linearise(model, now.p + steps, weights, below=now.merit if left else -np.inf)
        # The quadratic model may lack curvature, for example if a limit becomes active. Then a shorter step
        # often succeeds.
        poor = np.flatnonzero(new.merit >= now.merit)
        if poor.size:
            p, below = now.p[poor] + _SHORTER * steps[poor], now.merit[poor] if left else -np.inf
            new.put(poor, linearise(model, p, weights, below=below)._replace(damping=new.damping[poor]))
        gain = now.merit - new.merit
        better = gain > 0.0
        ratio = gain / np.maximum(expected, 1e-15)
        factor = np.where(~better, 6.0, np.where(ratio > 0.7, 0.2, np.where(ratio > 0.3, 0.5, 2.0)))
        # A motion is finished if its merit decreases by less than a thousandth, or if its step fails at a
        # damping above 1e3.
        little = gain < 1e-3 * (new.merit + 1e-4 * model.time)
        new.put(~better, now.take(~better))
        now = new._replace(damping=np.maximum(now.damping * factor, 1e-6))
        stays = ~np.where(better, little, now.damping > 1e3)
        motions.put(live[~stays], now.take(~stays))
        if not stays.all():
            live, now = live[stays], now.take(stays)
        if not live.size:
            break
    motions.put(live, now)
    return motions


def _weights(end: float, fade_speed: float, fade_distance: float, tie_break: float = 10.0) -> Weights:
    return Weights(end, max(1e3, 0.1 * end), tie_break, fade_speed, fade_distance)


# The weight of the goal increases tenfold from stage to stage, because a large weight in the first stage
# would keep motions in the wrong homotopy class. The smoothing decreases.
LAST_WEIGHTS = _weights(1e5, 0.0, 0.0, 1.0)._replace(firm=True)
# Iterations and weights of the stages of `refine`: the first on the coarse spline, two on the fine spline.
_LATER = (2, _weights(1e3, 0.03, 0.01)), (2, _weights(1e4, 0.03, 0.002)), (4, LAST_WEIGHTS)


def coarse_stage(model: Model, p: FloatArray) -> Candidates:
    """Apply a few iterations to control points (S, M, n); return up to six best motions after a few more."""
    first, then = _weights(1e2, 0.3, 0.03), _weights(1e2, 0.1, 0.03)
    motions = distinct_best(linearise(model, p, first, 0.3), len(p))
    motions = distinct_best(descend(motions, first, 3), 6)
    return descend(linearise(model, motions.p, then, motions.damping), then, 2)


def refine(pool: Candidates, fine: Model, keep: tuple[int, int, int], repeats: int = 1) -> Candidates:
    """Select and refine motions of a pool in three stages; return the final motions, the best first.

    The first stage uses the coarse spline, the second and third the fine spline. `keep` has the largest
    number of motions in each stage. `repeats` multiplies the iterations of each stage.
    """
    model, motions = pool.model, pool
    for k, (most, (iterations, weights)) in enumerate(zip(keep, _LATER, strict=True)):
        p = distinct_best(motions, most).p
        if k == 1:
            model, p = fine, embedded(pool.model.spline, fine.spline, p, fine.problem.joint_rates)
        motions = descend(linearise(model, p, weights), weights, repeats * iterations)
    return distinct_best(motions, keep[-1])


def distinct_best(motions: Candidates, keep: int) -> Candidates:
    """Return the best motions that differ by more than 0.05 rad or m in a joint, at most `keep`.

    Motions are ranked by the sum of the smoothed merit, 0.3 times the exact objective, and a penalty. With
    the `blocked_share` b the penalty is (b - 1)^2 if b > 1. Without the penalty a short motion through a body
    has a good rank, but a descent cannot resolve the collision.
    """
    chosen: list[int] = []
    travels = motions.model.spline.travel.free @ motions.p
    excess = np.maximum(motions.blocked_share - 1.0, 0.0)
    ranking = motions.merit + 0.3 * motions.objective + excess**2
    for i in np.argsort(ranking, kind="stable"):
        if all(np.max(np.abs(travels[i] - travels[j])) > 0.05 for j in chosen):
            chosen.append(int(i))
        if len(chosen) == keep:
            break
    return motions.take(chosen)


def tighten(motion: Candidates, iterations: int = 4) -> Candidates:
    """Increase the weights of goal and limits, up to five times, until the motion satisfies both."""
    weights = LAST_WEIGHTS
    for _ in range(5):
        satisfied = motion.limit_share[0] <= _SATISFIED
        if satisfied and motion.end_share[0] <= 0.8 and motion.late_share[0] <= 0.975:
            break
        weights = weights.stiffer()
        motion = descend(linearise(motion.model, motion.p, weights, motion.damping), weights, iterations)
    return motion


def prefer_limits(motion: Candidates) -> Candidates:
    """Reduce the weight of the goal, up to four times, until the motion satisfies the limits."""
    for softness in (1e-1, 1e-2, 1e-3, 1e-4):
        if motion.limit_share[0] <= _SATISFIED:
            break
        motion = with_soft_goal(motion, softness)
    return motion


def with_soft_goal(motion: Candidates, softness: float) -> Candidates:
    """Descend with a goal whose weight is multiplied by `softness`, and with stiffer limits."""
    weights = LAST_WEIGHTS._replace(end=softness * LAST_WEIGHTS.end, limits=10.0 * LAST_WEIGHTS.limits)
    return descend(linearise(motion.model, motion.p, weights), weights, 15)


def arrival_error(goal: Goal, plan: Trajectory) -> float:
    """Return the largest error at the deadline, of the pose [m, rad] and a required twist [m/s, rad/s]."""
    last = float(plan.position_error[-1]), float(plan.orientation_error[-1])
    return float(end_errors(goal, *last, plan.contact_velocity, plan.duration).max())


def corrected_goal(problem: Problem, goal: Goal, plan: Trajectory) -> Goal | None:
    """Return the goal for the next descent, if a descent to `goal` gave `plan`; None if the plan arrives.

    The returned goal is `goal`, displaced by the pose error of the plan. Its reaches are smaller if the plan
    ends at the problem's goal, but is too far from this goal during the last tenth.
    """
    within = arrival_error(problem.goal, plan) <= problem.goal.tolerance
    if plan.reached and within:
        return None
    place, q = problem.goal.place(problem.duration), plan.q[-1]
    missed = place.pose_error(place.in_axes(problem.sms.at(q).end_effector_pose, q))
    displacement, turn = missed.displacement.value[:, 0, 0], pin.exp3(missed.vector[:, 0, 0])
    last = plan.t >= ARRIVAL_SHARE * plan.duration - 1e-9
    late = max(
        float(plan.position_error[last].max()) / problem.goal.reach,
        float(plan.orientation_error[last].max()) / problem.goal.orientation_reach,
    )
    # The factor on the reaches, which apply in the last tenth of the time.
    nearer = 0.95 / late if late > 1.0 and within else 1.0
    reaches = {"reach": nearer * goal.reach, "orientation_reach": nearer * goal.orientation_reach}
    return Changed(goal, lambda place: place.moved(displacement, turn), **reaches)
