"""The checked evaluation of parts (terms and limits) for the solvers; errors name the part."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.errors import InvalidValue, PartError
from ffsms_pin.opt.derivatives import Variable, Variables, gradient_watch
from ffsms_pin.opt.rollouts import Rollouts

if TYPE_CHECKING:
    from ffsms_pin.opt.step.state import StepState

# The value of "no bound" in a QP; it is finite, so that sums are finite.
UNBOUNDED = 1e20


class Rows(NamedTuple):
    """The constraints lower <= G u <= upper, up to a slack, on the joint rates u at a step's end.

    Attributes
    ----------
    G : ndarray, shape (k, n)
        The coefficients.
    lower, upper : ndarray, shape (k,)
        The bounds; +-`UNBOUNDED` if a row has one side only.
    softness : float
        The relaxation of a row per unit of the QP's slack, in the row's unit per (m/s). With 0 the row is
        hard, for limits that every step can satisfy.
    """

    G: FloatArray
    lower: FloatArray
    upper: FloatArray
    softness: float = 0.0


def stacked(rows: list[Rows]) -> Rows | None:
    """Stack several rows into one object with their largest softness; return None if the list is empty."""
    if len(rows) < 2:
        return rows[0] if rows else None
    G, lower, upper = (np.concatenate(parts) for parts in zip(*(row[:3] for row in rows), strict=True))
    return Rows(G, lower, upper, max(row.softness for row in rows))


class Violation(NamedTuple):
    """The violation of a limit by a finished motion.

    Attributes
    ----------
    amount : float
        The largest violation, in the limit's own unit; zero if the limit is satisfied.
    instants : ndarray, shape (k,)
        Times at which the limit is active or violated [s].
    note : str
        A description of the violation, with values and units; empty if the limit is satisfied.
    nearest : str
        A description of the nearest pair of bodies, for the note of a plan that does not reach its target.
    overlap : str
        A description of an overlap with an obstacle, with which no motion can start; empty if there is none.
    """

    amount: float = 0.0
    instants: FloatArray = np.empty(0)
    note: str = ""
    nearest: str = ""
    overlap: str = ""


# The result of a part's formula.
Formula: TypeAlias = "Variable | Sequence[Formula]"
NUMERICAL = (np.linalg.LinAlgError, ArithmeticError)  # numerical failures, not programming errors
_WRITE = "compute it from m.tip, m.frame(...), m.rates, m.joints, ... (docs/own-parts.md)"
_LOST = (
    "a NumPy function converted a variable to a plain array; use x.norm(), x.dot(y), np.maximum(x, y), ... "
    "instead of np.linalg.norm, np.clip, np.where, ..., or x.value if no slope is needed (docs/own-parts.md)"
)


# The required type of each method's result, and its name in messages.
_KINDS: dict[str, tuple[Any, str]] = {
    "rows": ((Rows, type(None)), "opt.Rows or None"),
    "step_objective": ((tuple, type(None)), "a matrix and a vector, or None"),
    "violation": (Violation, "an opt.Violation"),
    "violation_in_flight": (Violation, "an opt.Violation"),
    "share": ((int, float, np.number), "a number"),
}


def checked_parts(name: str, parts: Any, kind: type[Any]) -> tuple[Any, ...]:
    """Return parts as a tuple; raise `InvalidValue` for a wrong type, and for an empty or repeated name."""
    if isinstance(parts, str) or not isinstance(parts, Sequence):
        raise InvalidValue(name, parts, f"must be a sequence of opt.{kind.__name__}")
    for i, part in enumerate(parts):
        if not isinstance(part, kind):
            raise InvalidValue(f"{name}[{i}]", part, f"must be an opt.{kind.__name__}")
        if not isinstance(part.name, str) or not part.name:
            raise InvalidValue(f"{name}[{i}]", part, "must have a `name`, a string that is not empty")
    names = [part.name for part in parts]
    if repeated := [name for name in names if names.count(name) > 1]:
        raise InvalidValue(
            name, repeated[0], "must have different names; set another `name` for one of the parts"
        )
    return tuple(parts)


def residuals_of(part: Any, motions: Rollouts | Variables) -> list[Variable]:
    """Return the residuals of a term or limit for motions, without empty residuals."""
    variables = motions if isinstance(motions, Variables) else Variables(motions)
    return [residual for residual in formulas(part, "residual", variables) if residual.value.size]


def evaluate(part: Any, method: str, argument: Any) -> Any:
    """Call a method of a part; raise `PartError` if it fails or returns another type."""
    try:
        result = getattr(part, method)(argument)
    except PartError:
        raise
    except Exception as error:
        raise PartError.of(part, method, error) from error
    kinds, required = _KINDS.get(method, (object, ""))
    if not isinstance(result, kinds):
        raise PartError(part, method, f"must return {required}; got {type(result).__name__}")
    return result


def rows_of(limit: Any, step: StepState) -> Rows | None:
    """Return the rows of a limit in a step; raise `PartError` for wrong shapes."""
    rows: Rows | None = evaluate(limit, "rows", step)
    if rows is None:
        return None
    k, n = len(rows.lower), len(step.rates)
    try:
        shapes = rows.G.shape, rows.lower.shape, rows.upper.shape
    except AttributeError:  # sequences instead of arrays
        shapes = np.shape(rows.G), np.shape(rows.lower), np.shape(rows.upper)
    if shapes != ((k, n), (k,), (k,)):
        raise PartError(limit, "rows", f"must return G (k, {n}), lower (k,) and upper (k,); got {shapes}")
    return rows


def objective_of(term: Any, step: StepState) -> tuple[FloatArray, FloatArray] | None:
    """Return the objective that a term adds to a step; raise `PartError` for wrong shapes."""
    objective: tuple[FloatArray, FloatArray] | None = evaluate(term, "step_objective", step)
    n = len(step.rates)
    if objective is not None and (shapes := [np.shape(array) for array in objective]) != [(n, n), (n,)]:
        required = f"must return arrays of shapes ({n}, {n}) and ({n},), or None"
        raise PartError(term, "step_objective", f"{required}; got {', '.join(map(str, shapes))}")
    return objective


def violation_of(limit: Any, motion: Rollouts, method: str = "violation") -> Violation:
    """Return the violation of a limit, with a note; the method for recordings is "violation_in_flight"."""
    violation: Violation = evaluate(limit, method, motion)
    if violation.amount > 0.0 and not violation.note:
        return violation._replace(note=f"the limit '{limit.name}' is violated by {violation.amount:.3g}")
    return violation


def share_of(term: Any, motion: Rollouts) -> float:
    """Return the cost of a finished motion by a term; raise `PartError` if it does not fit into a float."""
    try:
        return float(evaluate(term, "share", motion))
    except OverflowError:
        raise PartError(term, "share", "must return a number that fits into a float") from None


def formulas(part: Any, method: str, variables: Variables) -> list[Variable]:
    """Return the variables of a part's formula as a flat list; raise `PartError` for other results."""
    result, slopes_lost = gradient_watch(lambda: evaluate(part, method, variables))
    if slopes_lost:
        raise PartError(part, method, f"loses slopes: {_LOST}")
    return [_checked(part, method, value, variables) for value in _flat(result)]


def check_own_parts(parts: Sequence[Any], motion: Rollouts) -> None:
    """Raise `PartError` if the residual of a user's own part fails on a motion, or is not a variable.

    Numerical failures are ignored, because they may occur for this motion only; the solver handles them.
    """
    own = [part for part in parts if not type(part).__module__.startswith("ffsms_pin.")]
    if not own:
        return
    variables = Variables(motion)
    with np.errstate(all="ignore"):
        for part in own:
            try:
                residuals_of(part, variables)
            except PartError as error:
                if not isinstance(error.__cause__, NUMERICAL):
                    raise


def _flat(result: Any) -> list[Any]:
    return (
        [value for item in result for value in _flat(item)] if isinstance(result, (list, tuple)) else [result]
    )


def _checked(part: Any, method: str, value: Any, variables: Variables) -> Variable:
    """Return a variable unchanged; raise `PartError` for another type or a wrong shape."""
    if not isinstance(value, Variable):
        if isinstance(value, (np.ndarray, np.generic, float, int)):
            raise PartError(part, method, f"returns a plain array without slopes: {_WRITE}")
        raise PartError(
            part, method, f"must return a variable, or a list of these; got {type(value).__name__}: {_WRITE}"
        )
    S, K = variables.rollouts.rates.shape[1:]
    if value.where is None and (value.shape[-2:] != (S, K) or value.ndim > 3):
        shapes = f"{(S, K)} or (c, S, K) = (c, {S}, {K})"
        raise PartError(part, method, f"must return shape (S, K) = {shapes}; got {value.shape}")
    return value
