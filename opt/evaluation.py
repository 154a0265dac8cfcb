"""The answers of terms and limits, evaluated and checked for the solvers; errors name the part."""

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

# What stands for "no bound" in a quadratic programme; finite, so that sums stay numbers.
UNBOUNDED = 1e20


class Rows(NamedTuple):
    """Rows lower <= G u <= upper, up to a slack, in the joint rates u at the step's end.

    Attributes
    ----------
    G : ndarray, shape (k, n)
    lower, upper : ndarray, shape (k,)
        `UNBOUNDED` with its sign where a row has one side only.
    give : float
        How far a row gives way per unit of the programme's slack, in the row's unit per metre a second; 0:
        never, for what can always be kept.
    """

    G: FloatArray
    lower: FloatArray
    upper: FloatArray
    softness: float = 0.0


def stacked(rows: list[Rows]) -> Rows | None:
    """Rows one below the other, which all give way alike; None: no rows."""
    if len(rows) < 2:
        return rows[0] if rows else None
    G, lower, upper = (np.concatenate(parts) for parts in zip(*(one[:3] for one in rows), strict=True))
    return Rows(G, lower, upper, max(one.softness for one in rows))


class Violation(NamedTuple):
    """What a finished motion makes of a limit.

    Attributes
    ----------
    amount : float
        How far the limit is broken at most, in its own unit; zero where it is kept.
    instants : ndarray, shape (k,)
        Times at which the limit binds: where less than a small share of it is left, or it is broken [s].
    note : str
        What is broken, with values and units, in words; empty where the limit is kept.
    nearest : str
        What comes nearest to what, in words, of a limit that `blocks`: for a plan that it holds back.
    overlap : str
        What is inside an obstacle, in words: no motion can start like that.
    """

    amount: float = 0.0
    instants: FloatArray = np.empty(0)
    note: str = ""
    nearest: str = ""
    overlap: str = ""


# What a part's formula may be.
Formula: TypeAlias = "Variable | Sequence[Formula]"
NUMERICAL = (np.linalg.LinAlgError, ArithmeticError)  # failures of numbers, not of the program
_WRITE = "write it with m.tip, m.frame(...), m.rates, m.joints, ... (docs/own-parts.md)"
_LOST = (
    "a function of numpy made a plain array of a variable; take x.norm(), x.dot(y), np.maximum(x, y), ... in "
    "place of np.linalg.norm, np.clip, np.where, ..., and x.value where no slope is meant (docs/own-parts.md)"
)


# What methods must return, in words.
_KINDS: dict[str, tuple[Any, str]] = {
    "rows": ((Rows, type(None)), "opt.Rows or None"),
    "step_objective": ((tuple, type(None)), "a matrix and a vector, or None"),
    "violation": (Violation, "an opt.Violation"),
    "share": ((int, float, np.number), "a number"),
}


def checked_parts(name: str, parts: Any, kind: type) -> tuple[Any, ...]:
    """Parts of one kind, each with a name of its own."""
    if isinstance(parts, str) or not isinstance(parts, Sequence):
        raise InvalidValue(name, parts, f"must be a sequence of opt.{kind.__name__}")
    for i, part in enumerate(parts):
        if not isinstance(part, kind):
            raise InvalidValue(f"{name}[{i}]", part, f"must be an opt.{kind.__name__}")
        if not isinstance(part.name, str) or not part.name:
            raise InvalidValue(f"{name}[{i}]", part, "must have a `name`, a text")
    names = [part.name for part in parts]
    if twice := [one for one in names if names.count(one) > 1]:
        raise InvalidValue(name, twice[0], "must have one part of each name; give yours another `name`")
    return tuple(parts)


def residuals_of(part: Any, motions: Rollouts | Variables) -> list[Variable]:
    """Residuals of a term or a limit at motions; variables are theirs, which several parts can share."""
    seen = motions if isinstance(motions, Variables) else Variables(motions)
    return [one for one in formulas(part, "residual", seen) if one.value.size]


def evaluate(part: Any, method: str, seen: Any) -> Any:
    """What a method of a part gives; an error in it, or another kind of answer, names part and method."""
    try:
        found = getattr(part, method)(seen)
    except PartError:
        raise
    except Exception as error:
        raise PartError.of(part, method, error) from error
    kinds, wanted = _KINDS.get(method, (object, ""))
    if not isinstance(found, kinds):
        raise PartError(part, method, f"must return {wanted}; got {type(found).__name__}")
    return found


def rows_of(limit: Any, step: StepState) -> Rows | None:
    """Rows of a limit in a step, of the right shapes."""
    rows: Rows | None = evaluate(limit, "rows", step)
    if rows is None:
        return None
    k, n = len(rows.lower), len(step.rates)
    try:
        shapes = rows.G.shape, rows.lower.shape, rows.upper.shape
    except AttributeError:  # no arrays
        shapes = np.shape(rows.G), np.shape(rows.lower), np.shape(rows.upper)
    if shapes != ((k, n), (k,), (k,)):
        raise PartError(limit, "rows", f"must give G (k, {n}), lower (k,) and upper (k,); got {shapes}")
    return rows


def objective_of(term: Any, step: StepState) -> tuple[FloatArray, FloatArray] | None:
    """What a term adds to a step's objective, of the right shapes."""
    found: tuple[FloatArray, FloatArray] | None = evaluate(term, "step_objective", step)
    n = len(step.rates)
    if found is not None and [np.shape(one) for one in found] != [(n, n), (n,)]:
        raise PartError(term, "step_objective", f"must give a matrix ({n}, {n}) and a vector ({n},), or None")
    return found


def violation_of(limit: Any, motion: Rollouts) -> Violation:
    """What a finished motion makes of a limit."""
    found: Violation = evaluate(limit, "violation", motion)
    return found


def share_of(term: Any, motion: Rollouts) -> float:
    """What a term comes to for a finished motion."""
    try:
        return float(evaluate(term, "share", motion))
    except OverflowError:
        raise PartError(term, "share", "must return a number that fits into a float") from None


def formulas(part: Any, method: str, variables: Variables) -> list[Variable]:
    """Return the variables that a part's formula gives, flat and checked."""
    answer, slopes_lost = gradient_watch(lambda: evaluate(part, method, variables))
    if slopes_lost:
        raise PartError(part, method, f"loses slopes: {_LOST}")
    return [_checked(part, method, one, variables) for one in _flat(answer)]


def check_own_parts(parts: Sequence[Any], motion: Rollouts) -> None:
    """Raise `PartError` where the formula of a user's own part fails on a motion, or gives no variables.

    Numerical failures are left to the solver: the formula may have no value on this motion alone.
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


def _flat(found: Any) -> list[Any]:
    return [one for each in found for one in _flat(each)] if isinstance(found, (list, tuple)) else [found]


def _checked(part: Any, method: str, found: Any, variables: Variables) -> Variable:
    """Return a variable as it is; raise `PartError` for anything else, and for a wrong shape."""
    if not isinstance(found, Variable):
        if isinstance(found, (np.ndarray, np.generic, float, int)):
            raise PartError(part, method, f"returns a plain array, which has no slopes: {_WRITE}")
        raise PartError(
            part, method, f"must return a variable, or a list of these; got {type(found).__name__}: {_WRITE}"
        )
    S, K = variables.rollouts.rates.shape[1:]
    if found.where is None and (found.shape[-2:] != (S, K) or found.ndim > 3):
        shapes = f"{(S, K)} or (c, S, K) = (c, {S}, {K})"
        raise PartError(part, method, f"must return shape (S, K) = {shapes}; got {found.shape}")
    return found
