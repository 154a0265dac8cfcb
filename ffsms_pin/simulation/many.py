"""Parallel simulations of closed loops, for studies over plants, initial states and noise."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ffsms_pin.checks import common_length, dimensions
from ffsms_pin.processes import map_in_processes
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.simulation.closed_loop import check_options, simulate
from ffsms_pin.simulation.tracking import Tracking


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
    """Simulate several closed loops in parallel; each result equals that of `simulate` bit for bit.

    Reference, controller, plant and conditions may each be one object for all simulations, or a list, tuple
    or iterator with one object per simulation; `q0` may have one row per simulation. All other arguments are
    shared by all simulations.

    Parameters
    ----------
    sms : SpaceManipulator
        The model from which references and controllers were made.
    reference, controller, dt, q0, plant, **options
        The arguments of `simulate`. Each simulation works on copies of these objects.
    progress : callable, optional
        A function called with the completed share of the simulations, 0 to 1.
    jobs : int, optional
        The number of processes; 1 uses the present process. Default: the number of cores. With several
        processes a script must call this function below `if __name__ == "__main__":`, because the processes
        import the script.

    Returns
    -------
    list of Tracking
        The recordings in the order of the arguments. The recording of a run of 12 s with seven joints and
        the default `dt` takes about 7 MB of memory.

    Raises
    ------
    InvalidValue
        Sequences of different lengths, an unknown option, or a number of jobs that is not from 1 to 1024.
    TasksFailed
        Some simulations failed. The error has the reasons, and the results of the successful simulations.
    TaskError
        An argument cannot be sent to another process, or a process died.

    Examples
    --------
    >>> plants = random_plants(sms, np.random.default_rng(1), 200)
    >>> runs = ffsms.simulate_many(sms, plan, controller, plant=plants)
    """
    arguments = {"reference": reference, "controller": controller, "dt": dt, "q0": q0, "plant": plant}
    arguments |= options
    rows = {name: rows for name, value in arguments.items() if (rows := _rows(name, value)) is not None}
    count = common_length(rows)
    check_options("simulate_many", arguments)
    # A controller may refer to `sms`. Each task contains both, so that copies of the controller refer to the
    # copy of `sms`.
    tasks = [(sms, {**arguments, **{name: values[i] for name, values in rows.items()}}) for i in range(count)]
    runs = map_in_processes(_simulate, tasks, jobs, progress)
    return [replace(run) for run in runs]  # arrays from another process are writable; `replace` freezes them


def _simulate(task: tuple[SpaceManipulator, dict[str, Any]]) -> Tracking:
    sms, arguments = task
    return simulate(sms, **arguments)


def _rows(name: str, value: Any) -> list[Any] | None:
    """Return a list with one value per simulation, or None if one value serves all."""
    if name == "q0":  # two dimensions: one row per simulation
        return list(np.asarray(value)) if value is not None and dimensions(name, value) == 2 else None
    if name in ("reference", "controller", "plant", "conditions") and isinstance(
        value, (list, tuple, Iterator)
    ):
        return list(value)
    return None
