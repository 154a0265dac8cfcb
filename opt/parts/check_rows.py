"""Whether a limit's rows of a step say what a step then does."""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import PartError
from ffsms_pin.opt.limits.limit import UNBOUNDED, Limit, Rows
from ffsms_pin.opt.motion.at_step import StepFeatures
from ffsms_pin.opt.motion.motions import Motions
from ffsms_pin.opt.motion.rollout import configurations
from ffsms_pin.opt.parts.inequality import Inequality
from ffsms_pin.opt.parts.reading import residuals_of, rows_of
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.step.state import StepState
from ffsms_pin.system.base_motion import advance

__all__ = ["check_rows"]

_STEP = 1e-5  # [s, rad/s] that a state is carried on for in a difference


def check_rows(limit: Limit, problem: Problem, motion: Motions, tolerance: float) -> float:
    """The largest relative error of rows at the nodes of a motion.

    Raises
    ------
    PartError
        Rows are wrong, in shape or in value.
    """
    largest = 0.0
    for k, q in enumerate(configurations(problem.sms, problem.q0, motion)):
        if k == 0:  # at the start lengths that count from it are zero, and have no slopes
            continue
        state = _state(problem, q, motion.rates[:, 0, 2 * k], float(motion.times[2 * k]))
        rows = rows_of(limit, state)
        if rows is None:
            continue
        if isinstance(limit, Inequality):
            largest = max(largest, _flow_error(limit, problem, state, tolerance))
        else:
            _leads_out(limit, problem, state, rows)
    return largest


def _state(problem: Problem, q: FloatArray, rates: FloatArray, t: float) -> StepState:
    left = problem.duration - t
    total = problem.wheel_total if problem.wheels is not None else None
    return StepState(
        problem.sms,
        q,
        rates,
        problem.dt,
        left,
        problem.momentum,
        problem.q0[:7],
        t,
        problem.mode,
        total,
    )


def _moved(problem: Problem, state: StepState, rates: FloatArray, by: float) -> StepState:
    """The state a little later, on the way with these rates."""
    q, _ = advance(problem.sms, state.q, rates, np.zeros_like(rates), by, problem.momentum, problem.mode)
    return _state(problem, q, state.rates, state.time + by)


def _flow_error(limit: Inequality, problem: Problem, state: StepState, tolerance: float) -> float:
    """Of the change of an inequality's room with the joint rates, against a step that is taken."""
    here = StepFeatures(state)
    at, u = here.change(limit.rooms(here)), state.rates
    ahead, behind = (
        limit.rooms(StepFeatures(_moved(problem, state, u, by))).value.reshape(-1) for by in (_STEP, -_STEP)
    )
    jumps = at.jump.any(axis=1)  # how these change with the state does not count
    flow = np.where(jumps, 0.0, at.flow @ u + at.flow_drift - (ahead - behind) / (2.0 * _STEP))
    scale = max(float(np.abs(at.flow).max(initial=0.0)), float(np.abs(at.jump).max(initial=0.0)), 1e-6)
    errors = [float(np.abs(flow).max(initial=0.0)) / scale]
    if jumps.any():
        for j, unit in enumerate(np.eye(len(u))):
            sides = (
                limit.rooms(StepFeatures(_state(problem, state.q, u + by * unit, state.time))).value.reshape(
                    -1
                )
                for by in (_STEP, -_STEP)
            )
            change = np.subtract(*sides) / (2.0 * _STEP)
            errors.append(float(np.abs(change - at.jump[:, j])[jumps].max()) / scale)
    if max(errors) > tolerance:
        raise PartError(
            limit,
            "rows",
            f"are wrong: with the joint rates room changes otherwise, by {max(errors):.3g} of it",
        )
    return max(errors)


def _leads_out(limit: Limit, problem: Problem, state: StepState, rows: Rows) -> None:
    """Where a limit is broken, a single row with one side must not lead deeper into it."""
    if len(rows.lower) != 1:
        return
    outwards = float(rows.lower[0] > -UNBOUNDED) - float(rows.upper[0] < UNBOUNDED)
    before = _penalty(limit, state)
    if outwards == 0.0 or before == 0.0:
        return
    after = _penalty(limit, _moved(problem, state, outwards * rows.G[0], _STEP))
    if after > before * (1.0 + 1e-9):
        raise PartError(limit, "rows", "lead deeper into the limit where it is broken: a sign is wrong")


def _penalty(limit: Limit, state: StepState) -> float:
    return sum(float(np.sum(one.value**2)) for one in residuals_of(limit, StepFeatures(state).motions))
