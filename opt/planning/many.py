"""Many plans at once, over processes: `plan_many` for a list of them, `plan_each` for any number."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import repeat
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.engine import Outcome, all_results, outcomes
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.planning.plan import KAPPA, plan
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.trajectory import Trajectory
from ffsms_pin.system import SpaceManipulator

__all__ = ["plan_each", "plan_many"]


def plan_many(
    sms: SpaceManipulator,
    q0: ArrayLike | Sequence[ArrayLike],
    target: Any,
    duration: ArrayLike = Problem.duration,
    dt: float = Problem.dt,
    kappa: float = KAPPA,
    *,
    jobs: int | None = None,
    progress: Callable[[float], None] | None = None,
    **options: Any,
) -> list[Trajectory]:
    """Plan many motions, each as `plan` does, bit for bit.

    Arguments as for `plan`; of start, target and duration each may be one, for all motions, or a sequence
    with one a motion. The plans are in the order of the arguments.

    Parameters
    ----------
    q0 : array_like, shape (nq,) or (N, nq)
    target : array_like, shape (3,) or (N, 3), or pinocchio.SE3, or sequence of both kinds
    duration : float or array_like, shape (N,)
        [s]
    jobs : int, optional
        Processes to work with; 1 for this one alone. Default: one a core.
    progress : callable, optional
        Called with the share of the motions planned, 0 to 1.

    Raises
    ------
    InvalidValue
        Sequences of different lengths, an unknown option, or a number of jobs below one.
    TasksFailed
        Some could not be planned: it says which and why, and carries the others.

    Examples
    --------
    >>> plans = opt.plan_many(sms, q0, targets, duration=12.0)
    >>> reached = [plan.reached for plan in plans]
    """
    if isinstance(target, Iterator):
        target = list(target)
    starts, targets = _rows("q0", q0), _targets(target)
    durations = _rows("duration", duration, one=0)
    count = _count(q0=starts, target=targets, duration=durations)
    each = zip(
        repeat(q0, count) if starts is None else starts,
        repeat(target, count) if targets is None else targets,
        repeat(duration, count) if durations is None else durations,
        strict=True,
    )
    found = plan_each(sms, each, dt, kappa, jobs=1 if count < 2 and jobs is None else jobs, **options)
    return all_results(found, count, progress)


def plan_each(
    sms: SpaceManipulator,
    tasks: Iterable[tuple[ArrayLike, Any, float]],
    dt: float = Problem.dt,
    kappa: float = KAPPA,
    *,
    jobs: int | None = None,
    **options: Any,
) -> Iterator[Outcome[Trajectory]]:
    """Plan any number of motions, yielding each in turn: the memory taken does not grow with their number.

    Parameters
    ----------
    tasks : iterable of (q0, target, duration)
        Taken as they are needed, so it may be a generator, and endless; the rest is as for `plan_many`.

    Yields
    ------
    Outcome
        `index`, and either the `result`, a Trajectory, or the `error` that `plan` raised.

    Examples
    --------
    >>> for outcome in opt.plan_each(sms, ((q0, draw(), 12.0) for _ in range(100_000))):
    ...     arrived += outcome.error is None and outcome.result.reached
    """
    known = [
        name
        for name, parameter in inspect.signature(plan).parameters.items()
        if parameter.kind is parameter.KEYWORD_ONLY and name != "progress"
    ]
    for name in options:
        if name not in known:
            raise InvalidValue("option", name, f"must be one of {', '.join(known)}")
    found = outcomes(_plan, (sms, dt, kappa, options), tasks, jobs)
    # On its way from a process an array becomes writable; a copy's are not.
    return (one if one.result is None else replace(one, result=replace(one.result)) for one in found)


def _plan(shared: Any, task: Any) -> Trajectory:
    sms, *numbers, options = shared
    return plan(sms, *task, *numbers, **options)


def _targets(target: Any) -> list[Any] | None:
    """The targets one by one, or None where there is one for all."""
    if hasattr(target, "translation"):
        return None
    if isinstance(target, Sequence) and any(hasattr(one, "translation") for one in target):
        return list(target)
    return _rows("target", target)


def _rows(name: str, value: Any, one: int = 1) -> list[Any] | None:
    """What is given one a motion, or None where it has the `one` dimension of a single motion's."""
    try:
        dimensions = np.ndim(value)
    except ValueError:  # rows of different lengths: planning says what is wrong with each
        return list(value)
    if dimensions == one and np.size(value):
        return None
    if dimensions not in (1, one + 1):
        raise InvalidValue(name, value, "must be one for all motions, or a sequence with one a motion")
    return list(value if isinstance(value, Sequence) else np.asarray(value))


def _count(**sequences: list[Any] | None) -> int:
    """How many motions the sequences are for; one where there is none."""
    lengths = {name: len(rows) for name, rows in sequences.items() if rows is not None}
    if len(set(lengths.values())) > 1:
        told = ", ".join(f"{count} of {name}" for name, count in lengths.items())
        raise InvalidValue("the sequences", told, "must have one length")
    return next(iter(lengths.values()), 1)
