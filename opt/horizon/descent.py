"""Levenberg-Marquardt within the joint limits, for several motions side by side, in stages.

Successive halving: many motions for a few iterations, the best of them for more, on a finer spline.

References: J. Nocedal, S. J. Wright, "Numerical Optimization", 2nd ed., 2006, ch. 10; K. Jamieson, A.
Talwalkar, "Non-stochastic best arm identification and hyperparameter optimization", 2016.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.goals.goal import Changed, Goal
from ffsms_pin.opt.goals.near import end_errors
from ffsms_pin.opt.horizon.merit import Candidates, Model, Weights, linearise
from ffsms_pin.opt.horizon.spline import embedded
from ffsms_pin.opt.motion.motions import ARRIVAL_SHARE
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.trajectory import Trajectory

_SHORTER = 0.3  # share of a step that is tried where the whole one fails
_LACK = 0.5  # share of a limit's margin at which a motion has landed


def descend(model: Model, motions: Candidates, weights: Weights, iterations: int) -> Candidates:
    """Iterate, all motions in step; those that stall drop out. Changes `motions` and returns it."""
    live, now = np.arange(len(motions.p)), motions
    for left in reversed(range(iterations)):
        damped = now.hessian + now.damping[:, None, None] * model.damping
        solved = zip(damped, now.gradient, now.p, strict=True)
        steps = np.stack([model.qp.solve(H, g, p) for H, g, p in solved])
        flat = steps.reshape(now.gradient.shape)
        expected = -np.einsum("si,si->s", flat, 2.0 * now.gradient + (now.hessian @ flat[..., None])[..., 0])
        # What follows begins under other weights, or is the end: the last iteration needs no derivatives.
        new = linearise(model, now.p + steps, weights, below=now.merit if left else -np.inf)
        # Curvature that the model lacks, as of a limit that begins to bind on the way, often spares a shorter
        # step.
        poor = np.flatnonzero(new.merit >= now.merit)
        if poor.size:
            p, below = now.p[poor] + _SHORTER * steps[poor], now.merit[poor] if left else -np.inf
            new.put(poor, linearise(model, p, weights, below=below)._replace(damping=new.damping[poor]))
        gain = now.merit - new.merit
        better = gain > 0.0
        ratio = gain / np.maximum(expected, 1e-15)
        factor = np.where(~better, 6.0, np.where(ratio > 0.7, 0.2, np.where(ratio > 0.3, 0.5, 2.0)))
        # Motions drop out that gain less than a thousandth, or whose step fails even under so much damping.
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


# The end's weight grows from stage to stage, by ten each: a stiff end from the start would hold motions on
# the wrong way round. The smoothing is taken back meanwhile.
LAST_WEIGHTS = _weights(1e5, 0.0, 0.0, 1.0)._replace(firm=True)
# Iterations of those that go on, on the coarse spline and then on the fine one.
_LATER = (2, _weights(1e3, 0.03, 0.01)), (2, _weights(1e4, 0.03, 0.002)), (4, LAST_WEIGHTS)


def take_down(model: Model, p: FloatArray) -> Candidates:
    """A few iterations with starts (S, M, n), and a few more with the best of them."""
    first, then = _weights(1e2, 0.3, 0.03), _weights(1e2, 0.1, 0.03)
    motions = distinct_best(model, linearise(model, p, first, 0.3), len(p))
    motions = distinct_best(model, descend(model, motions, first, 3), 6)
    return descend(model, linearise(model, motions.p, then, motions.damping), then, 2)


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
        motions = descend(model, linearise(model, p, weights), weights, repeats * iterations)
    return distinct_best(fine, motions, keep[-1])


def distinct_best(model: Model, motions: Candidates, keep: int) -> Candidates:
    """The `keep` best motions; of those whose joints stay within 0.05 rad or m of each other only the best.

    Beside the smoothed merit the true objective counts, and the square of the largest lack of a clearance, in
    margins beyond the first: a short way through a body weighs little, and a descent does not find out of it.
    """
    chosen: list[int] = []
    places = model.spline.travel.free @ motions.p
    beyond = np.maximum(motions.blocked_share - 1.0, 0.0)
    worth = motions.merit + 0.3 * motions.objective + beyond**2
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
        if motion.limit_share[0] <= _LACK and motion.end_share[0] <= 0.8 and motion.late_share[0] <= 0.975:
            break
        weights = weights.stiffer()
        motion = descend(model, linearise(model, motion.p, weights, motion.damping), weights, 4)
    return motion


def prefer_limits(model: Model, motion: Candidates) -> Candidates:
    """Where limits and goal cannot both be had: within the limits, as near to the goal as they allow."""
    for softer in (1e-1, 1e-2, 1e-3, 1e-4):
        if motion.limit_share[0] <= _LACK:
            break
        weights = LAST_WEIGHTS._replace(end=softer * LAST_WEIGHTS.end, limits=10.0 * LAST_WEIGHTS.limits)
        motion = descend(model, linearise(model, motion.p, weights), weights, 15)
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
