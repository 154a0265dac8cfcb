"""Many closed-loop simulations at once, over processes: for studies over plants, starts and noise."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import common_length, dimensions
from ffsms_pin.engine import Outcome, all_results, outcomes
from ffsms_pin.errors import InvalidValue
from ffsms_pin.simulation.closed_loop import simulate
from ffsms_pin.simulation.tracking import Tracking
from ffsms_pin.system import SpaceManipulator

# Dimensions of one start, start velocity or momentum; with one more there is a row a simulation.
_ROWS = ("q0", "v0", "momentum")


def simulate_many(
    sms: SpaceManipulator,
    reference: Any,
    controller: Any,
    dt: float = 1e-3,
    q0: ArrayLike | None = None,
    plant: Any = None,
    progress: Callable[[float], None] | None = None,
    *,
    jobs: int | None = None,
    **options: Any,
) -> list[Tracking]:
    """Simulate many closed loops, each as `simulate` does, bit for bit.

    Of reference, controller, plant and sensors each may be one, for all simulations, or a list, tuple or
    iterator with one a simulation; start, `v0` and `momentum` likewise, with one row a simulation. All the
    rest is the same for all.

    Parameters
    ----------
    sms : SpaceManipulator
    reference, controller, dt, q0, plant, **options
        As for `simulate`. Each simulation works on copies, so a controller with a memory starts afresh.
    progress : callable, optional
        Called with the share of the simulations done, 0 to 1.
    jobs : int, optional
        Processes to work with; 1 for this one alone. Default: one a core.

    Returns
    -------
    list of Tracking
        In the order of the arguments. A run of 12 s holds some 4 MB; where all of them are too much, take
        them one by one with `simulate_each`.

    Raises
    ------
    InvalidValue
        Sequences of different lengths, an unknown option, or a number of jobs below one.
    TasksFailed
        Some did not run to their end: it says which and why, and carries the others.

    Examples
    --------
    >>> plants = random_plants(sms, np.random.default_rng(1), 200)
    >>> runs = ffsms.simulate_many(sms, plan, controller, plant=plants)
    """
    arguments = {"reference": reference, "controller": controller, "dt": dt, "q0": q0, "plant": plant}
    arguments |= options
    rows = {name: rows for name, value in arguments.items() if (rows := _rows(name, value)) is not None}
    count = common_length(rows)
    tasks = ({**arguments, **{name: values[i] for name, values in rows.items()}} for i in range(count))
    _check_names(arguments)
    found = simulate_each(sms, tasks, jobs=1 if count < 2 and jobs is None else jobs)
    return all_results(found, count, progress)


def simulate_each(
    sms: SpaceManipulator, tasks: Iterable[Mapping[str, Any]], *, jobs: int | None = None
) -> Iterator[Outcome[Tracking]]:
    """Simulate any number of closed loops, yielding each in turn: the memory taken does not grow with them.

    Parameters
    ----------
    sms : SpaceManipulator
    tasks : iterable of dict
        Arguments of `simulate` by name, `reference` and `controller` among them; taken as they are needed, so
        it may be a generator, and endless.
    jobs : int, optional
        As for `simulate_many`.

    Yields
    ------
    Outcome
        `index`, and either the `result`, a Tracking, or the `error` that `simulate` raised. That of a run
        that was stopped carries what was recorded.
    """
    # The manipulator goes with every task, so that a controller made with it still shares it there.
    try:
        waiting = iter(tasks)
    except TypeError:
        raise InvalidValue("tasks", tasks, "must give dicts of arguments of simulate") from None
    found = outcomes(_simulate, None, ((sms, _arguments(task)) for task in waiting), jobs, largest_chunk=1)
    # On its way from a process an array becomes writable; a copy's are not.
    return (one if one.result is None else replace(one, result=replace(one.result)) for one in found)


def _arguments(task: Any) -> dict[str, Any]:
    if not isinstance(task, Mapping):
        raise InvalidValue("task", task, "must be a dict of arguments of simulate")
    return dict(task)


def _simulate(_: None, task: tuple[SpaceManipulator, dict[str, Any]]) -> Tracking:
    sms, arguments = task
    _check_names(arguments)
    return simulate(sms, **arguments)


def _rows(name: str, value: Any) -> list[Any] | None:
    """The values one a simulation, or None where there is one for all."""
    if name in _ROWS:
        return list(np.asarray(value)) if value is not None and dimensions(name, value) == 2 else None
    if name in ("reference", "controller", "plant", "sensors") and isinstance(value, (list, tuple, Iterator)):
        return list(value)
    return None


def _check_names(arguments: Mapping[str, Any]) -> None:
    known = [name for name in inspect.signature(simulate).parameters if name not in ("sms", "progress")]
    for name in arguments:
        if name not in known:
            raise InvalidValue("option", name, f"must be one of {', '.join(known)}")
    for name in ("reference", "controller"):
        if name not in arguments:
            raise InvalidValue("task", sorted(arguments), f"must hold a {name}")
