"""Plans of scenarios that differ in what flies them only: each is made once a process."""

from __future__ import annotations

import pickle

from ffsms_pin.opt import Problem, SearchOptions, Trajectory
from ffsms_pin.opt.plans import plan_problem
from ffsms_pin.opt.step.state import Progress

__all__ = ["kept_plan"]

_KEPT: dict[bytes, Trajectory] = {}


def kept_plan(
    problem: Problem,
    method: str = "horizon",
    options: SearchOptions | None = None,
    progress: Progress | None = None,
) -> Trajectory:
    """As `plan_problem`; a problem that was planned before has that plan again.

    Problems are the same where all that they hold is, to the bit. Parts count by the names of their classes:
    not for parts that a test writes itself, and not for tests that ask whether two plans are the same.
    """
    key = pickle.dumps((problem, method, options))
    if key not in _KEPT:
        _KEPT[key] = plan_problem(problem, method, options, progress)
    elif progress is not None:
        progress(1.0)
    return _KEPT[key]
