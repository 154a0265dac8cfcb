"""Marches of the paper's step: as starts of the search, and as plans of their own.

Where nothing stops it, a march costs nothing and moves the joints little, and it may arrive where no straight
joint-space move does. As a start it is taken on the cost's cone without limits, all sides at once: one damped
least-squares solution a step does for the programme. As a plan it is marched with every limit, step by step.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.coupling.stacked import entropies, singular_values
from ffsms_pin.opt.batch.motions import apply_rates
from ffsms_pin.opt.horizon.control_qp import at_rest
from ffsms_pin.opt.horizon.options import SearchOptions
from ffsms_pin.opt.horizon.spline import RateSpline
from ffsms_pin.opt.horizon.starts import joint_range
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.step.direction import ARRIVAL_POWER, LEAST_APPROACH
from ffsms_pin.opt.step.march import Progress, Steps, march, sides_across, start_sides
from ffsms_pin.opt.step.programme import StepWeights
from ffsms_pin.opt.step.stepper import Stepper
from ffsms_pin.opt.trajectory import Trajectory, measure
from ffsms_pin.system.base_motion import advance
from ffsms_pin.system.batch.arm import ArmValues
from ffsms_pin.system.batch.stacks import apply, dot, exp3

__all__ = [
    "cone_marches",
    "free_marches",
    "landed",
    "march_starts",
    "marched",
    "reference_stepper",
    "straight_march",
]

# The references are about what they spare: ten times the step's own price of redundant motion, and still too
# little to keep an arm from leaving a singular start.
REFERENCE_WEIGHTS = StepWeights(effort=1e-5)

_DAMPING = 0.003  # [arm lengths] of the least squares, near singular postures
_SHARE = 0.8  # of the rate limits
_STRIDES = 60  # a step of a march with all limits is at most such a part of the time left
_BEHIND = 1.5  # at such a multiple of the way that is left at the mean speed a march is given up
_BRAKING = 0.5  # of the acceleration limits, at the end of such a march


def march_starts(problem: Problem, spline: RateSpline, options: SearchOptions) -> FloatArray:
    """Control points (S, M, n) nearest to the marches."""
    rates = cone_marches(problem, options.march_steps)
    middles = (np.arange(options.march_steps) + 0.5) * problem.duration / options.march_steps
    maps = spline.rates_at(middles)
    rest = rates - maps.fixed[:, None] * problem.joint_rates
    return np.asarray(np.linalg.pinv(maps.free) @ rest)


def free_marches(problem: Problem, budget: float) -> Iterator[FloatArray]:
    """Joint rates (N + 1, n) of marches that cost less than a budget [s], one for each side, landed.

    A march is given up where it has cost more, where a step's programme was not solved, or where it is so far
    behind its schedule that it will not arrive. Far from the
    deadline a step is longer than one of the motion: nothing changes fast there. In between the rates are
    linear.
    """
    place, sms, dt, steps = problem.goal.place(problem.duration), problem.sms, problem.dt, problem.steps
    stepper = Stepper.of(problem)
    mode = problem.mode
    for side in start_sides(sms, problem.q0, place.position, mode):
        stepper.reset(side)
        q, cost, k, nodes, rates = problem.q0, 0.0, 0, [0], [problem.joint_rates]
        while k < steps:
            stride = max(1, (steps - k) // _STRIDES)
            stepper.dt = stride * dt
            # The paper pairs rates with where the arm was one step before.
            before, _ = advance(sms, q, rates[-1], np.zeros(sms.n), stepper.dt - dt, problem.momentum, mode)
            step = stepper.advance(before, rates[-1], place.position, (steps - k) * dt, place.rotation)
            cost += step.cost * stepper.dt
            way = place.position - sms.at(q).end_effector_pose.translation
            behind = float(np.linalg.norm(way)) > _BEHIND * problem.mean_speed * (steps - k) * dt
            if cost > budget or not step.solved or behind:
                break
            slope = (step.joint_rates - rates[-1]) / stepper.dt
            q, _ = advance(sms, q, rates[-1], slope, stepper.dt, problem.momentum, mode)
            k += stride
            nodes.append(k)
            rates.append(step.joint_rates)
        else:
            yield landed(problem, _between(np.array(nodes), np.array(rates)))


def straight_march(problem: Problem) -> Trajectory:
    """The motion of single steps straight to the target, under all limits: that of "resolved-rate"."""
    return marched(problem, reference_stepper(problem, "resolved-rate"))


def reference_stepper(problem: Problem, method: str) -> Stepper:
    """The stepper of one of the classical references."""
    return Stepper.of(problem, method, REFERENCE_WEIGHTS, limits=problem.step_limits, terms=())


def marched(problem: Problem, stepper: Steps, progress: Progress | None = None) -> Trajectory:
    """The finished motion of single steps to the problem's goal."""
    place = problem.goal.place(problem.duration)
    start, end = (problem.q0, problem.joint_rates), (place.position, problem.duration, place.rotation)
    rates, note = march(stepper, *start, *end, progress)
    return measure(problem, rates, note)


def landed(problem: Problem, rates: FloatArray) -> FloatArray:
    """The same motion (N + 1, n), at rest at the end: slowed down where a joint would brake too late.

    All joints by the same share, so that the end effector keeps its direction, and with it the cost.
    """
    left = np.arange(len(rates))[::-1, None]
    most = at_rest(problem) + _BRAKING * problem.dt * left * np.minimum(problem.sms.limits.acceleration, 1e6)
    share = np.min(most / np.maximum(np.abs(rates), 1e-12), axis=1, keepdims=True)
    share[0] = 1.0  # the rates at the start are given
    return np.asarray(rates * np.minimum(share, 1.0))


def _between(nodes: FloatArray, rates: FloatArray) -> FloatArray:
    """Rates (N + 1, n) at every node of the motion, linear between those of some (k,), (k, n)."""
    at = np.arange(nodes[-1] + 1)
    return np.stack([np.interp(at, nodes, one) for one in rates.T], axis=1)


def cone_marches(problem: Problem, steps: int) -> FloatArray:
    """Joint rates (S, steps, n) in the middles of steps: a march for each side of the cone, one straight."""
    stack, dt, kappa = problem.stack, problem.duration / steps, problem.kappa
    wanted_place = problem.goal.place(problem.duration)
    low, high = joint_range(problem)
    most = np.where(problem.free, _SHARE * np.minimum(problem.sms.limits.velocity, 1e6), 0.0)[:, None]
    J = problem.rotation0 @ problem.arm0.jstar[..., 0]
    sides = sides_across(problem.place_now.position - problem.tip0, J)
    straight = np.append(np.zeros(len(sides), dtype=bool), True)
    lateral = np.array([*sides, np.ones(3)]).T  # of the straight one it does not matter
    count = len(straight)
    joints = np.repeat(problem.joints0[:, None], count, axis=1)
    R = np.repeat(problem.rotation0[..., None], count, axis=2)
    out, speed = np.zeros((count, steps, stack.n)), np.zeros(count)
    for k in range(steps):
        arm = stack.evaluate(joints)
        com = problem.com0 + (k * dt) * problem.drift
        place = wanted_place.at(com[:, None] - apply(R, arm.com), R)
        missed = place.missed(com[:, None] + apply(R, arm.rho), apply(R, arm.tip_rotation))
        way = missed.way
        distance = np.sqrt(dot(way, way)) + 1e-12
        d = way / distance
        cosine = np.where(straight, 1.0, _ideal_cosine(arm, kappa))
        lateral = lateral - dot(lateral, d) * d
        lateral = lateral / (np.sqrt(dot(lateral, lateral)) + 1e-12)
        e = cosine * d + np.sqrt(np.maximum(1.0 - cosine**2, 0.0)) * lateral
        left = problem.duration - k * dt
        share = ARRIVAL_POWER / (left + 0.5 * ARRIVAL_POWER * dt)
        speed = np.minimum(
            share * distance / np.maximum(cosine, LEAST_APPROACH), speed + _gain(problem, steps, distance)
        )
        J, wanted = apply(R, arm.jstar), speed * e - problem.drift[:, None]
        turning = apply(R, arm.spin + arm.axes * stack.moves_tip[:, None])
        J = np.concatenate([J, missed.along(turning)])
        wanted = np.concatenate([wanted, share * missed.turn])
        u = _least_squares(J, wanted, _DAMPING * stack.length)
        u *= np.minimum(1.0, 1.0 / np.maximum(np.abs(u / np.maximum(most, 1e-12)).max(axis=0), 1e-12))
        u = np.clip(np.where(most > 0.0, u, 0.0), (low[:, None] - joints) / dt, (high[:, None] - joints) / dt)
        out[:, k] = u.T
        joints = joints + dt * u
        R = apply(R, exp3(dt * apply_rates(arm.spin, u)))
    return out


def _gain(problem: Problem, steps: int, distance: FloatArray) -> FloatArray:
    """How much the speed may rise in a step: over a tenth of the time to its mean [m/s]."""
    return np.asarray(
        10.0 / steps * np.maximum(problem.mean_speed, distance / problem.duration) * ARRIVAL_POWER
    )


def _ideal_cosine(arm: ArmValues, kappa: float) -> FloatArray:
    """The cosine c* of no cost, log(exp(kappa (1 - H)) - 1) / kappa, within [-1, 1]."""
    sigma = singular_values(arm.coupling)
    x = np.maximum(kappa * (1.0 - entropies(sigma, arm.jstar.shape[1])), 1e-9)
    return np.asarray(np.clip((x + np.log(-np.expm1(-x))) / kappa, -1.0, 1.0))


def _least_squares(J: FloatArray, wanted: FloatArray, damping: float) -> FloatArray:
    """Least joint rates (n, S) with J u near to what is wanted (m, S), for Jacobians (m, n, S)."""
    A = J.transpose(2, 0, 1)
    At = A.swapaxes(1, 2)
    square = A @ At + damping**2 * np.eye(len(wanted))
    # Damping must not slow what can be done: one step of refinement takes most of it back.
    first = np.linalg.solve(square, wanted.T[..., None])
    rest = wanted.T[..., None] - A @ (At @ first)
    u: FloatArray = (At @ (first + np.linalg.solve(square, rest)))[..., 0].T
    return u
