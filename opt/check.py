"""The check of a part's derivatives against finite differences, on random motions of a problem."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import numpy as np

from ffsms_pin.checks import FloatArray, Indices, instance, positive, whole
from ffsms_pin.errors import FfsmsWarning, InvalidValue, PartError
from ffsms_pin.opt.costs import Term
from ffsms_pin.opt.derivatives import StepVariables, Variable, Variables
from ffsms_pin.opt.evaluation import UNBOUNDED, Rows, formulas, residuals_of, rows_of
from ffsms_pin.opt.limits.limit import AllOf, Inequality, Limit, prepared
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.rollouts import FixedRollouts, Rollouts, configurations, coupling_slopes
from ffsms_pin.opt.step.state import StepState
from ffsms_pin.robot.base_motion import advance
from ffsms_pin.system.batch.stacks import apply, exp3

# The names of slopes, and the fields of motions that they are derivatives by.
_MOVED = {
    "by_tip": "end_effector",
    "by_turn": "attitude",
    "by_velocity": "velocity",
    "by_spin": "angular_velocity",
    "by_base": "base_position",
    "by_base_turn": "base_attitude",
    "by_base_spin": "base_angular_velocity",
    "by_entropy": "entropy",
    "by_joints": "joints",
    "by_rates": "rates",
    "by_accelerations": "accelerations",
}
_STEP = 1e-5  # [s, rad/s^2] the time step, or acceleration, of a finite difference


def check(part: Term | Limit, problem: Problem, tolerance: float = 1e-4, seed: int = 0) -> float:
    """Check a part's slopes by finite differences on random motions; return the largest error.

    For an `opt.Inequality` these are the slopes of its slack, and the rows of a step against a step that is
    taken. For another limit they are the slopes of its residual, and the sign of its rows at a violation.

    Parameters
    ----------
    part : Term or Limit
    problem : Problem
        The problem with robot, start, goal, mode and momentum; its own terms and limits are ignored.
    tolerance : float
        The largest error of a slope, relative to the largest slope of its residual.
    seed : int
        The seed of the random motions.

    Raises
    ------
    PartError
        If a slope is wrong, with part, slope and both values in the text; or if the part fails or a shape is
        wrong.
    """
    if not isinstance(part, (Term, Limit)):
        raise InvalidValue("part", part, "must be an opt.Term or an opt.Limit")
    instance("problem", problem, Problem)
    positive("tolerance", tolerance)
    whole("seed", seed, 0)
    if isinstance(part, Limit):
        part = prepared(part, problem.sms)
    if isinstance(part, AllOf):
        return max((check(inequality, problem, tolerance, seed) for inequality in part.parts), default=0.0)
    method = "slack" if isinstance(part, Inequality) else "residual"
    rng, largest, seen = np.random.default_rng(seed), 0.0, False
    for speed in (0.1, 0.3, 1.0):  # [rad/s]
        rates = speed * rng.normal(size=(6, problem.sms.n))
        motions = replace(problem.motion(rates, problem.duration / 5), delay=problem.dt)
        for i, answer in enumerate(_dense(part, method, motions)):
            seen = seen or bool(answer.value.any())
            largest = max(largest, _compared(part, method, i, answer, motions, tolerance))
        if isinstance(part, Limit):
            largest = max(largest, _check_rows(part, problem, motions, tolerance))
    if not seen:
        text = f"{type(part).__name__}.{method} is zero on all random motions: its slopes are not checked;"
        text += " check it with a weight, or with a tighter limit"
        warnings.warn(text, FfsmsWarning, stacklevel=2)
    return largest


def _dense(part: Any, method: str, motions: Rollouts) -> list[Variable]:
    """Evaluate a part; return each variable at all instants, with all its slopes."""

    def spread(values: FloatArray, motion: Indices | None, instants: Indices | slice) -> FloatArray:
        full = np.zeros((*values.shape[:-2], *motions.rates.shape[1:]))
        if motion is None:
            full[..., instants] = values
        else:
            full[..., motion, instants] = values[..., 0, :]
        return full

    dense = []
    for answer in formulas(part, method, Variables(motions)):
        if not answer.value.size:  # as for wheels if none hold the attitude
            continue
        if np.isnan(answer.value).any():
            raise PartError(part, method, "returns NaN or infinity")
        where = answer.where or (None, slice(None))
        try:
            slopes = {name: spread(slope, *where) for name, slope in answer.slopes.items()}
        except Exception as error:
            raise PartError.of(part, method, error) from error
        dense.append(Variable(spread(answer.value, *where), slopes))
    return dense


def _compared(
    part: Any, method: str, i: int, variable: Variable, motions: Rollouts, tolerance: float
) -> float:
    """Return the largest error of answer i's slopes, relative to the largest of them."""
    by_name: dict[str, Any] = variable.by_all()
    by_name.pop("by_time", None)  # the explicit time dependence, in steps only
    if "by_coupling" in by_name:  # C_bm depends on the joints
        by = coupling_slopes(motions.stack, motions.arm, by_name.pop("by_coupling"))
        by_name["by_joints"] = by_name.get("by_joints", 0.0) + by

    def error_by(step: float) -> tuple[float, str]:
        wanted: dict[str, Any] = _by_differences(lambda at: _dense(part, method, at)[i].value, motions, step)
        finite, largest, worst, description = np.isfinite(variable.value), 1e-3, 0.0, ""  # less is rounding
        for name in by_name | wanted:
            mine, its = np.broadcast_arrays(by_name.get(name, 0.0), wanted.get(name, 0.0))
            counts = finite if variable.ndim == 2 or name == "by_entropy" else finite[:, None]
            error = np.where(counts, np.abs(mine - its), 0.0)
            k = np.unravel_index(int(np.argmax(error)), error.shape)
            largest = max(largest, float(np.abs(mine).max()), float(np.abs(its).max()))
            if error[k] > worst:
                worst, j = float(error[k]), [int(index) for index in k[variable.ndim - 2 : -2]]
                description = f"{name}{j} of answer {i} is {mine[k]:.6g} where differences give {its[k]:.6g}"
        return worst / largest, f"{description} (the largest slope is {largest:.3g})"

    # A longer difference reduces rounding, such as that of distances.
    error, description = min(map(error_by, (1e-6, 1e-4)))
    if error > tolerance:
        raise PartError(part, method, f"gives a wrong slope: {description}")
    return error


# -- finite differences by each quantity alone


@dataclass(frozen=True, eq=False, kw_only=True)
class _Nudged(FixedRollouts):
    """A rollout with independent quantities, so that each can be varied alone."""

    entropy: FloatArray


def _nudged(held: _Nudged, name: str, i: int, by: float) -> Rollouts:
    """Return the motions with component i of a field moved by `by`, at all instants."""
    values: Any = getattr(held, name)
    if values.ndim == 4:  # an attitude
        values = apply(exp3(by * np.eye(3)[i])[..., None, None], values)
    elif values.ndim == 2:
        values = values + by
    else:
        values = values.copy()
        values[i] += by
    moved = replace(held, **{name: values}, evaluated=None if name == "joints" else held.evaluated)
    if held.angular_momentum is None:
        return moved
    in_base_axes = np.einsum("yx...,y->x...", moved.base_attitude, held.angular_momentum)
    return replace(moved, angular_drift=apply(moved.arm.inverse, in_base_axes))


def _by_differences(
    formula: Callable[[Rollouts], FloatArray], motions: Rollouts, step: float = 1e-6
) -> dict[str, FloatArray]:
    """Return the slopes of a formula, (S, K) or (c, S, K), by each quantity; zero where not finite."""
    quantities: dict[str, Any] = {entry.name: getattr(motions, entry.name) for entry in fields(_Nudged)}
    held = _Nudged(**(quantities | {"evaluated": motions.arm}))
    slopes: dict[str, FloatArray] = {}
    for by, name in _MOVED.items():
        columns = []
        for i in range(1 if by == "by_entropy" else len(quantities[name])):
            ahead, behind = (formula(_nudged(held, name, i, size)) for size in (step, -step))
            apart = np.subtract(ahead, behind, out=np.zeros_like(ahead), where=np.isfinite(ahead))
            columns.append(apart / (2.0 * step))
        if np.any(columns):
            axis = columns[0].ndim - 2
            slopes[by] = columns[0] if by == "by_entropy" else np.stack(columns, axis=axis)
    return slopes


# -- rows of a step, compared with the step taken


def _check_rows(limit: Limit, problem: Problem, motion: Rollouts, tolerance: float) -> float:
    """Return the largest relative error of a limit's rows at the nodes of a motion."""
    largest, nodes = 0.0, configurations(problem.sms, problem.q0, motion)
    for k in range(1, len(nodes)):  # lengths from the start are zero there, and have no slopes
        state = _state(problem, nodes[k], motion.rates[:, 0, 2 * k], float(motion.times[2 * k]))
        rows = rows_of(limit, state)
        if rows is None:
            continue
        if isinstance(limit, Inequality):
            largest = max(largest, _flow_error(limit, problem, state, tolerance))
        else:
            _leads_out(limit, problem, state, rows)
    return largest


def _state(problem: Problem, q: FloatArray, rates: FloatArray, t: float) -> StepState:
    total = problem.wheel_total if problem.wheels is not None else None
    settings = (problem.momentum, problem.q0[:7], t, problem.mode, total, problem.time_offset)
    return StepState(problem.sms, q, rates, problem.dt, problem.duration - t, *settings)


def _moved(problem: Problem, state: StepState, rates: FloatArray, by: float) -> StepState:
    """Return the state a little later, at these rates."""
    q, _ = advance(problem.sms, state.q, rates, np.zeros_like(rates), by, problem.momentum, problem.mode)
    return _state(problem, q, state.rates, state.time + by)


def _ending(problem: Problem, state: StepState, change: FloatArray, by: float) -> StepVariables:
    """Return the state with the rates at the step's end and the accelerations towards them."""
    seen = StepVariables(_state(problem, state.q, state.rates + by * change, state.time))
    seen.rollouts = replace(seen.rollouts, accelerations=by * change[:, None, None] / state.dt)
    return seen


def _flow_error(limit: Inequality, problem: Problem, state: StepState, tolerance: float) -> float:
    """Return the error of the slack's rate of change with the joint rates, against a step that is taken."""
    here = StepVariables(state)
    at, u = here.change(limit.slacks(here)), state.rates

    def slope(to: Callable[[float], Variables], step: float) -> FloatArray:
        ahead, behind = (limit.slacks(to(by)).value.reshape(-1) for by in (step, -step))
        return np.asarray((ahead - behind) / (2.0 * step))

    jumps = at.jump.any(axis=1)  # the change of these with the state is ignored
    change = slope(lambda by: StepVariables(_moved(problem, state, u, by)), _STEP)
    flow = np.where(jumps, 0.0, at.flow @ u + at.flow_drift - change)
    scale = max(1e-3, *(float(np.abs(x).max(initial=0.0)) for x in at[1:]))
    errors = [float(np.abs(flow).max(initial=0.0)) / scale]
    for j, unit in enumerate(np.eye(len(u)) if jumps.any() else ()):
        change = slope(partial(_ending, problem, state, unit), _STEP * state.dt)
        errors.append(float(np.abs(change - at.jump[:, j])[jumps].max()) / scale)
    if max(errors) > tolerance:
        problem_text = (
            f"are wrong: with the joint rates the slack changes otherwise, by {max(errors):.3g} of it"
        )
        raise PartError(limit, "rows", problem_text)
    return max(errors)


def _leads_out(limit: Limit, problem: Problem, state: StepState, rows: Rows) -> None:
    """Raise `PartError` if a single one-sided row leads deeper into a violated limit."""
    if len(rows.lower) != 1:
        return
    outwards = float(rows.lower[0] > -UNBOUNDED) - float(rows.upper[0] < UNBOUNDED)
    before, after = (
        sum(float(np.sum(residual.value**2)) for residual in residuals_of(limit, StepVariables(at).rollouts))
        for at in (state, _moved(problem, state, outwards * rows.G[0], _STEP))
    )
    if 0.0 < before * (1.0 + 1e-9) < after:
        raise PartError(limit, "rows", "lead deeper into the limit where it is broken: a sign is wrong")
