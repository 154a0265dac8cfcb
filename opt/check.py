"""The check of a term's or limit's derivatives against finite differences on random motions."""

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

# The name of each slope, and the field of `Rollouts` with respect to which it is the derivative.
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
_STEP = 1e-5  # step of finite differences in time [s] or in acceleration [rad/s^2]


def check(part: Term | Limit, problem: Problem, tolerance: float = 1e-4, seed: int = 0) -> float:
    """Check the slopes (derivatives) of a term or limit by finite differences on random motions.

    For a term the slopes of the residual are checked. For an `opt.Inequality` the slopes of the slack are
    checked, and the rows are compared with the change of the slack in a short step. For any other limit the
    slopes of the residual are checked. If such a limit is violated and has a single row with one bound, the
    sign of the row is checked, too.

    Parameters
    ----------
    part : Term or Limit
        The term or limit.
    problem : Problem
        The robot, start, goal, mode and momentum of the motions. The problem's own terms and limits are
        ignored.
    tolerance : float
        The largest admissible error of a slope, relative to the largest slope of the same residual or slack.
    seed : int
        The seed of the random motions.

    Returns
    -------
    float
        The largest relative error of slopes and rows.

    Raises
    ------
    PartError
        If a slope or a row is wrong, if a shape is wrong, or if a method of the part fails. For a wrong slope
        the message has the slope's name, its value and the finite difference.
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
    rng, largest, nonzero = np.random.default_rng(seed), 0.0, False
    for speed in (0.1, 0.3, 1.0):  # [rad/s]
        rates = speed * rng.normal(size=(6, problem.sms.n))
        motions = replace(problem.motion(rates, problem.duration / 5), delay=problem.dt)
        for i, variable in enumerate(_dense(part, method, motions)):
            nonzero = nonzero or bool(variable.value.any())
            largest = max(largest, _compared(part, method, i, variable, motions, tolerance))
        if isinstance(part, Limit):
            largest = max(largest, _check_rows(part, problem, motions, tolerance))
    if not nonzero:
        text = f"{type(part).__name__}.{method} is zero on all random motions, so its slopes were not"
        text += " checked; check it with a weight above zero, or with a tighter limit"
        warnings.warn(text, FfsmsWarning, stacklevel=2)
    return largest


def _dense(part: Any, method: str, motions: Rollouts) -> list[Variable]:
    """Return the variables of a part's formula as full arrays, zero at instants without a value."""

    def filled(values: FloatArray, motion: Indices | None, instants: Indices | slice) -> FloatArray:
        full = np.zeros((*values.shape[:-2], *motions.rates.shape[1:]))
        if motion is None:
            full[..., instants] = values
        else:
            full[..., motion, instants] = values[..., 0, :]
        return full

    dense = []
    for variable in formulas(part, method, Variables(motions)):
        if not variable.value.size:  # for example, momenta of wheels if no wheels hold the attitude
            continue
        if np.isnan(variable.value).any():
            raise PartError(part, method, "returns NaN; it must be defined for every motion")
        where = variable.where or (None, slice(None))
        try:
            slopes = {name: filled(slope, *where) for name, slope in variable.slopes.items()}
        except Exception as error:
            raise PartError.of(part, method, error) from error
        dense.append(Variable(filled(variable.value, *where), slopes))
    return dense


def _compared(
    part: Any, method: str, i: int, variable: Variable, motions: Rollouts, tolerance: float
) -> float:
    """Compare the slopes of variable i with finite differences; return the largest relative error.

    The error is the smaller of the errors for two steps of the finite differences.
    """
    by_name: dict[str, Any] = variable.by_all()
    by_name.pop("by_time", None)  # explicit time dependence, used in single steps only
    if "by_coupling" in by_name:  # C_bm is a function of the joint positions
        by = coupling_slopes(motions.stack, motions.arm, by_name.pop("by_coupling"))
        by_name["by_joints"] = by_name.get("by_joints", 0.0) + by

    def error_by(step: float) -> tuple[float, str]:
        differences: dict[str, Any] = _by_differences(
            lambda at: _dense(part, method, at)[i].value, motions, step
        )
        # Slopes below 1e-3 may be rounding errors, so relative errors refer to at least 1e-3.
        finite, largest, worst, description = np.isfinite(variable.value), 1e-3, 0.0, ""
        for name in by_name | differences:
            exact, numeric = np.broadcast_arrays(by_name.get(name, 0.0), differences.get(name, 0.0))
            compared = finite if variable.ndim == 2 or name == "by_entropy" else finite[:, None]
            error = np.where(compared, np.abs(exact - numeric), 0.0)
            k = np.unravel_index(int(np.argmax(error)), error.shape)
            largest = max(largest, float(np.abs(exact).max()), float(np.abs(numeric).max()))
            if error[k] > worst:
                worst, j = float(error[k]), [int(index) for index in k[variable.ndim - 2 : -2]]
                description = f"{name}{j} of variable {i} is {exact[k]:.6g}, but finite differences give "
                description += f"{numeric[k]:.6g}"
        return worst / largest, f"{description} (the largest slope is {largest:.3g})"

    # The longer step has smaller rounding errors, for example for distances.
    error, description = min(map(error_by, (1e-6, 1e-4)))
    if error > tolerance:
        raise PartError(part, method, f"has a wrong slope: {description}")
    return error


# -- finite differences with respect to one quantity at a time


@dataclass(frozen=True, eq=False, kw_only=True)
class _Nudged(FixedRollouts):
    """A stack of motions whose quantities are stored, so that each can be varied alone."""

    entropy: FloatArray


def _nudged(motions: _Nudged, name: str, i: int, by: float) -> Rollouts:
    """Return the motions with component `i` of the field `name` changed by `by` at all instants."""
    values: Any = getattr(motions, name)
    if values.ndim == 4:  # an attitude
        values = apply(exp3(by * np.eye(3)[i])[..., None, None], values)
    elif values.ndim == 2:
        values = values + by
    else:
        values = values.copy()
        values[i] += by
    moved = replace(motions, **{name: values}, evaluated=None if name == "joints" else motions.evaluated)
    if motions.angular_momentum is None:
        return moved
    in_base_axes = np.einsum("yx...,y->x...", moved.base_attitude, motions.angular_momentum)
    return replace(moved, angular_drift=apply(moved.arm.inverse, in_base_axes))


def _by_differences(
    formula: Callable[[Rollouts], FloatArray], motions: Rollouts, step: float = 1e-6
) -> dict[str, FloatArray]:
    """Return the slopes of a formula (S, K) or (c, S, K) by central differences, zero at infinities."""
    quantities: dict[str, Any] = {entry.name: getattr(motions, entry.name) for entry in fields(_Nudged)}
    independent = _Nudged(**(quantities | {"evaluated": motions.arm}))
    slopes: dict[str, FloatArray] = {}
    for by, name in _MOVED.items():
        columns = []
        for i in range(1 if by == "by_entropy" else len(quantities[name])):
            ahead, behind = (formula(_nudged(independent, name, i, size)) for size in (step, -step))
            difference = np.subtract(ahead, behind, out=np.zeros_like(ahead), where=np.isfinite(ahead))
            columns.append(difference / (2.0 * step))
        if np.any(columns):
            axis = columns[0].ndim - 2
            slopes[by] = columns[0] if by == "by_entropy" else np.stack(columns, axis=axis)
    return slopes


# -- rows of a step, compared with a short step


def _check_rows(limit: Limit, problem: Problem, motion: Rollouts, tolerance: float) -> float:
    """Return the largest relative error of a limit's rows at the nodes of a motion except the first."""
    largest, nodes = 0.0, configurations(problem.sms, problem.q0, motion)
    for k in range(1, len(nodes)):  # the base's displacement has no slope at the start
        state = _state(problem, nodes[k], motion.rates[:, 0, 2 * k], float(motion.times[2 * k]))
        rows = rows_of(limit, state)
        if rows is None:
            continue
        if isinstance(limit, Inequality):
            largest = max(largest, _flow_error(limit, problem, state, tolerance))
        else:
            _check_sign(limit, problem, state, rows)
    return largest


def _state(problem: Problem, q: FloatArray, rates: FloatArray, t: float) -> StepState:
    total = problem.wheel_total if problem.wheels is not None else None
    settings = (problem.momentum, problem.q0[:7], t, problem.mode, total, problem.time_offset)
    return StepState(problem.sms, q, rates, problem.dt, problem.duration - t, *settings)


def _moved(problem: Problem, state: StepState, rates: FloatArray, by: float) -> StepState:
    """Return the state after a motion of `by` [s] at constant joint `rates`, with the rates of `state`."""
    q, _ = advance(problem.sms, state.q, rates, np.zeros_like(rates), by, problem.momentum, problem.mode)
    return _state(problem, q, state.rates, state.time + by)


def _ending(problem: Problem, state: StepState, change: FloatArray, by: float) -> StepVariables:
    """Return the variables of a step at whose end the rates have changed by `by` times `change`."""
    variables = StepVariables(_state(problem, state.q, state.rates + by * change, state.time))
    variables.rollouts = replace(variables.rollouts, accelerations=by * change[:, None, None] / state.dt)
    return variables


def _flow_error(limit: Inequality, problem: Problem, state: StepState, tolerance: float) -> float:
    """Return the relative error of the slack's rate of change; raise `PartError` if it is too large."""
    here = StepVariables(state)
    at, u = here.change(limit.slacks(here)), state.rates

    def slope(to: Callable[[float], Variables], step: float) -> FloatArray:
        ahead, behind = (limit.slacks(to(by)).value.reshape(-1) for by in (step, -step))
        return np.asarray((ahead - behind) / (2.0 * step))

    jumps = at.jump.any(axis=1)  # slacks that depend on rates; their change with positions is not checked
    change = slope(lambda by: StepVariables(_moved(problem, state, u, by)), _STEP)
    flow = np.where(jumps, 0.0, at.flow @ u + at.flow_drift - change)
    scale = max(1e-3, *(float(np.abs(x).max(initial=0.0)) for x in at[1:]))
    errors = [float(np.abs(flow).max(initial=0.0)) / scale]
    for j, unit in enumerate(np.eye(len(u)) if jumps.any() else ()):
        change = slope(partial(_ending, problem, state, unit), _STEP * state.dt)
        errors.append(float(np.abs(change - at.jump[:, j])[jumps].max()) / scale)
    if max(errors) > tolerance:
        text = "are wrong: the rate of the slack from its slopes differs from its change in a short step by"
        remedy = "of the largest rate; check the slopes of slack(m)"
        raise PartError(limit, "rows", f"{text} {max(errors):.3g} {remedy}")
    return max(errors)


def _check_sign(limit: Limit, problem: Problem, state: StepState, rows: Rows) -> None:
    """Raise `PartError` if a short step into the half-space of a row increases the violation of the limit.

    Only limits with a single row with one bound are checked.
    """
    if len(rows.lower) != 1:
        return
    direction = float(rows.lower[0] > -UNBOUNDED) - float(rows.upper[0] < UNBOUNDED)
    before, after = (
        sum(float(np.sum(residual.value**2)) for residual in residuals_of(limit, StepVariables(at).rollouts))
        for at in (state, _moved(problem, state, direction * rows.G[0], _STEP))
    )
    if 0.0 < before * (1.0 + 1e-9) < after:
        raise PartError(limit, "rows", "increase the violation of the limit; check their sign")
