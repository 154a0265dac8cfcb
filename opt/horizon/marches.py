"""Marches of single steps, with every limit, as plans of their own.

Where nothing stops it, a march of the paper's step costs nothing and moves the joints little.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.horizon.control_qp import at_rest
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.step.march import Progress, Steps, march, start_sides
from ffsms_pin.opt.step.programme import StepWeights
from ffsms_pin.opt.step.stepper import Stepper
from ffsms_pin.opt.trajectory import Trajectory, measure
from ffsms_pin.system.base_motion import advance

__all__ = [
    "REFERENCE_WEIGHTS",
    "free_marches",
    "landed",
    "marched",
    "reference_stepper",
    "straight_march",
]

# The references are about what they spare: ten times the step's own price of redundant motion, and still too
# little to keep an arm from leaving a singular start. Re-planned motions have it too: a goal at the edge of
# the workspace is not worth fast joints.
REFERENCE_WEIGHTS = StepWeights(effort=1e-5)

_STRIDES = 60  # a step of a march with all limits is at most such a part of the time left
_BEHIND = 1.5  # at such a multiple of the way that is left at the mean speed a march is given up
_BRAKING = 0.5  # of the acceleration limits, at the end of such a march


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
    q0, rates0, duration = problem.q0, problem.joint_rates, problem.duration
    rates, note = march(stepper, q0, rates0, place.position, duration, place.rotation, progress)
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
