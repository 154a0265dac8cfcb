"""Marches of single steps: coarse ones that a search starts from, free ones, and those of `plan`'s methods.

A greedy march of the paper's step is free of cost wherever nothing stops it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.horizon.control_qp import at_rest
from ffsms_pin.opt.horizon.shooting import joint_range
from ffsms_pin.opt.horizon.spline import RateSpline
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.step.march import Progress, Steps, march, sides_across, start_sides
from ffsms_pin.opt.step.nonlinear_step import NonlinearStepper
from ffsms_pin.opt.step.programme import StepWeights
from ffsms_pin.opt.step.stepper import Stepper
from ffsms_pin.opt.trajectory import Trajectory, measure
from ffsms_pin.system.base_motion import advance

__all__ = ["REFERENCE_WEIGHTS", "cone_marches", "free_marches", "landed", "march_starts", "marched"]

# Of the references, and of re-planned motions: ten times the step's own price of redundant motion, and still
# too little to keep an arm from leaving a singular start.
REFERENCE_WEIGHTS = StepWeights(effort=1e-5)


def march_starts(problem: Problem, spline: RateSpline, steps: int) -> FloatArray:
    """Control points (S, M, n) nearest to the marches of so many steps."""
    middles = (np.arange(steps) + 0.5) * problem.duration / steps
    return spline.nearest(middles, cone_marches(problem, steps), problem.joint_rates)


def cone_marches(problem: Problem, steps: int) -> FloatArray:
    """Joint rates (S, steps, n) in the middles of steps: a march for each side of the cone, one straight.

    A place that rides on the base, or is free about an axis, counts as seen from the start.
    """
    place = problem.goal.place(problem.duration).aim(problem.sms, problem.q0)
    low, high = joint_range(problem)
    most = np.where(problem.free, 0.8 * np.minimum(problem.sms.limits.velocity, 1e6), 0.0)
    J = problem.rotation0 @ problem.arm0.jstar[..., 0]
    sides = np.array([*sides_across(place.position - problem.tip0, J), np.zeros(3)])
    return kernel.cone_marches(
        problem.stack.tree,
        steps,
        problem.duration,
        problem.kappa,
        problem.mean_speed,
        0.003 * problem.stack.length,
        np.stack([problem.joints0, low, high, most]),
        np.stack([place.position, problem.com0, problem.drift]),
        problem.rotation0,
        place.rotation,
        sides,
    )


def free_marches(problem: Problem, budget: float) -> Iterator[FloatArray]:
    """Joint rates (N + 1, n) of marches that cost less than a budget [s], one for each side, landed.

    Given up where one has cost more, a step's programme was not solved, or it will not arrive in time.
    """
    place, sms, dt, steps = problem.goal.place(problem.duration), problem.sms, problem.dt, problem.steps
    stepper, mode = Stepper.of(problem), problem.mode
    for side in start_sides(sms, problem.q0, place.position, mode):
        stepper.reset(side)
        q, cost, k, nodes, rates = problem.q0, 0.0, 0, [0], [problem.joint_rates]
        while k < steps:
            stride = max(1, (steps - k) // 60)  # far from the deadline nothing changes fast
            stepper.dt = stride * dt
            # The paper pairs rates with where the arm was one step before.
            before, _ = advance(sms, q, rates[-1], np.zeros(sms.n), stepper.dt - dt, problem.momentum, mode)
            step = stepper.advance(before, rates[-1], place.position, (steps - k) * dt, place.rotation)
            cost += step.cost * stepper.dt
            way = place.position - sms.at(q).end_effector_pose.translation
            behind = float(np.linalg.norm(way)) > 1.5 * problem.mean_speed * (steps - k) * dt
            if cost > budget or not step.solved or behind:
                break
            slope = (step.joint_rates - rates[-1]) / stepper.dt
            q, _ = advance(sms, q, rates[-1], slope, stepper.dt, problem.momentum, mode)
            k += stride
            nodes.append(k)
            rates.append(step.joint_rates)
        else:
            at = np.arange(steps + 1)
            yield landed(problem, np.stack([np.interp(at, nodes, one) for one in np.array(rates).T], axis=1))


def marched(problem: Problem, method: str, progress: Progress | None = None) -> Trajectory:
    """The finished motion of single steps by a method of `plan`; for "step" the best of the cone's sides."""
    sms, limits = problem.sms, problem.step_limits
    if method == "paper":
        paper = NonlinearStepper(sms, problem.dt, problem.kappa, limits, problem.mode, problem.wheel_total)
        return _done(problem, paper, progress)
    if method != "step":
        reference = Stepper.of(problem, method, REFERENCE_WEIGHTS, limits=limits, terms=())
        return _done(problem, reference, progress)
    stepper = Stepper.of(problem, limits=limits)
    sides = start_sides(sms, problem.q0, problem.goal.place(problem.duration).position, problem.mode)
    plans: list[Trajectory] = []

    def told(share: float) -> None:
        if progress is not None:
            progress((len(plans) + share) / len(sides))

    for side in sides:
        stepper.reset(side)
        plans.append(_done(problem, stepper, told))
    # Plans that arrive by cost, before the others by how near they come.
    return min(
        plans, key=lambda one: (not one.reached, one.cost_integral if one.reached else one.position_error[-1])
    )


def _done(problem: Problem, stepper: Steps, progress: Progress | None) -> Trajectory:
    """The finished motion of a stepper's steps to the problem's goal."""
    place, start = problem.goal.place(problem.duration), (problem.q0, problem.joint_rates)
    rates, note = march(stepper, *start, place.position, problem.duration, place.rotation, progress)
    return measure(problem, rates, note)


def landed(problem: Problem, rates: FloatArray) -> FloatArray:
    """The same motion (N + 1, n), at rest at the end: slowed down where a joint would brake too late.

    A joint brakes with half of what it can; all slow down by one share, so that the cost stays.
    """
    left = np.arange(len(rates))[::-1, None]
    most = at_rest(problem) + 0.5 * problem.dt * left * np.minimum(problem.sms.limits.acceleration, 1e6)
    share = np.min(most / np.maximum(np.abs(rates), 1e-12), axis=1, keepdims=True)
    share[0] = 1.0  # the rates at the start are given
    return np.asarray(rates * np.minimum(share, 1.0))
