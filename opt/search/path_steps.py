"""Plans along a path by single steps under all limits."""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.goals.path import Path
from ffsms_pin.opt.problem import Problem, step_limits
from ffsms_pin.opt.search.diagnosis import noted
from ffsms_pin.opt.search.path_following import (
    PathNodes,
    check_begin,
    feedback_gain,
    path_task,
    resolved,
    rest_note,
)
from ffsms_pin.opt.step.state import REFERENCES, Progress, StepState, braked_note
from ffsms_pin.opt.step.stepper import Stepper
from ffsms_pin.opt.step.stepwise import REFERENCE_WEIGHTS
from ffsms_pin.opt.trajectory import Trajectory, measure
from ffsms_pin.robot.base_motion import advance

_IDENTITY = 0.1  # share of the identity in a weight matrix, which prevents a null-space drift to the limits


def plan_path_stepwise(problem: Problem, method: str, progress: Progress | None = None) -> Trajectory:
    """Plan along a path step by step, by a method of `plan`.

    The path determines the direction of motion, so the methods "step" and "resolved-rate" are the same. The
    other methods weight the redundant motion by the metric `REFERENCES[method]`. Each solved step has the
    joint rates within the limits that are nearest to the rates without limits.
    """
    path = problem.goal
    assert isinstance(path, Path)
    check_begin(problem, path)
    sms, dt, steps = problem.sms, problem.dt, problem.steps
    nodes, penalty = PathNodes.of(path, problem.nodes), REFERENCES[method]
    limits = step_limits(problem.limits, problem.mode)
    stepper = Stepper.of(problem, "resolved-rate", REFERENCE_WEIGHTS, limits=limits, terms=())
    stepper.reset(deadline=problem.duration)
    share = _IDENTITY * np.eye(sms.n)
    unbounded, still = np.full(sms.n, 1e9), np.zeros(sms.n)
    rates = np.empty((steps + 1, sms.n))
    q, rates[0], slope, braked = problem.q0, problem.joint_rates, still, 0
    for k in range(steps):
        left = problem.duration - k * dt
        ahead, _ = advance(sms, q, rates[k], slope, dt, problem.momentum, problem.mode)
        task = path_task(problem, nodes, k + 1, ahead, sms.layout.positions(ahead), feedback_gain(dt))
        weight: FloatArray | None = None
        if penalty is not None:
            total = problem.wheel_total
            state = StepState(
                sms, ahead, rates[k], dt, left, problem.momentum, mode=problem.mode, wheel_total=total
            )
            weight = np.asarray(share + penalty(state))
        desired = resolved(task, still, (-unbounded, unbounded), weight)
        place = path.place((k + 1) * dt).at(q).position
        step = stepper.advance(q, rates[k], place, left, prefer=desired)
        braked += not step.solved
        rates[k + 1] = step.joint_rates
        slope = (rates[k + 1] - rates[k]) / dt
        q, _ = advance(sms, q, rates[k], slope, dt, problem.momentum, problem.mode)
        if progress is not None:
            progress((k + 1) / steps)
    note = braked_note(braked, steps)
    plan = measure(problem, rates, note)
    return noted(plan, plan.note, rest_note(path))
