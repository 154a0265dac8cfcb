"""Share plans between scenarios that differ only in their simulation."""

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
    """Return a plan as `plan_problem` does, or the earlier plan of an identical problem.

    Problems are identical if their pickles are. A pickle has only the names of classes, so this function must
    not be used with terms and limits that a test defines, or in tests that compare two plans.
    """
    key = pickle.dumps((problem, method, options))
    if key not in _KEPT:
        _KEPT[key] = plan_problem(problem, method, options, progress)
    elif progress is not None:
        progress(1.0)
    return _KEPT[key]
