"""`solve`: from a problem to a trajectory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ffsms_pin.checks import instance, optional_callable
from ffsms_pin.errors import PartError
from ffsms_pin.opt.horizon.diagnosis import explain, refused, with_limits_said, within_workspace
from ffsms_pin.opt.horizon.options import SearchOptions
from ffsms_pin.opt.horizon.search import Search
from ffsms_pin.opt.horizon.strategies import QUICK, STRATEGIES
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.problem_checks import asked_momentum
from ffsms_pin.opt.trajectory import Trajectory, measure
from ffsms_pin.threads import one_blas_thread

__all__ = ["solve"]

_NUMERICAL = (np.linalg.LinAlgError, ArithmeticError)  # failures of numbers, not of the program


@one_blas_thread()
def solve(
    problem: Problem,
    options: SearchOptions | None = None,
    progress: Callable[[float], None] | None = None,
) -> Trajectory:
    """Plan the whole motion at once.

    Joint goals found by shooting, and coarse marches of the paper's step, give starts; Levenberg-Marquardt
    within the joint limits takes them down, the worse half dropping out each round. Of the motions that
    arrive and cost no more than the cheapest and a tolerance, the one of least effort is the plan.

    Parameters
    ----------
    problem : Problem
    options : SearchOptions, optional
        Numbers of the search, such as its `time_limit`.
    progress : callable, optional
        Called with the share of the work done, 0 to 1.

    Returns
    -------
    Trajectory
        `reached` says whether the goal was met; `note` what stood in the way; `shares` what each term came
        to; `binding` when each limit binds. A numerical failure inside is a plan with a note, too.

    Raises
    ------
    InvalidValue
        The start overlaps an obstacle, or the target lies inside one.
    """
    instance("problem", problem, Problem)
    instance("options", options, SearchOptions, optional=True)
    optional_callable("progress", progress)
    stays = refused(problem)
    if stays is not None:
        return stays

    def again(other: Problem) -> Trajectory:
        return Search(other, options).run(QUICK)

    search = None
    try:
        search = Search(problem, options, progress)
        plan = search.run(STRATEGIES)
        if not _finite(plan):
            raise FloatingPointError("the motion found is not a number")
        if not plan.reached and within_workspace(problem):
            plan = with_limits_said(problem, plan, again)
        if not (plan.reached and plan.within_tolerance):
            plan = explain(problem, plan, search.goals, search.binding(), lambda one: again(one).reached)
    except (*_NUMERICAL, PartError) as error:
        if isinstance(error, PartError) and not isinstance(error.__cause__, _NUMERICAL):
            raise  # a mistake in a part
        plan = _before_failure(problem, search, error)
    notes = [note for note in (plan.note, _momentum_note(problem)) if note]
    return replace(plan, note="; ".join(notes))


def _momentum_note(problem: Problem) -> str:
    """How far the problem's momentum is from the one that its goal asks for; empty where it is that."""
    asked = asked_momentum(problem.goal, problem.com0)
    if asked is None:
        return ""
    given = np.zeros(6) if problem.momentum is None else problem.momentum
    linear, angular = np.linalg.norm((given - asked).reshape(2, 3), axis=1)
    if np.allclose([linear, angular], 0.0, atol=1e-6 * float(np.abs(asked).max()) + 1e-9):
        return ""  # but for rounding
    return (
        f"the momentum before the capture is {linear:.3g} kg m/s and {angular:.3g} kg m^2/s from the one "
        "that leaves both at rest: so much is left after it"
    )


def _before_failure(problem: Problem, search: Search | None, error: Exception) -> Trajectory:
    """The best motion found before the numbers failed; without any, the arm stays where it is."""
    words = "the arm stays where it is"
    found = [] if search is None else [one for one in search.found if _finite(one.plan)]
    if search is not None and found:
        search.found = found
        plan, words = search.best().plan, "this is the best motion found before"
    else:
        plan = measure(problem, np.zeros((problem.steps + 1, problem.sms.n)))
    note = f"the search ended in a numerical failure ({error}): {words}"
    return replace(plan, note="; ".join(filter(None, [note, plan.note])))


def _finite(plan: Trajectory) -> bool:
    return bool(np.isfinite(plan.q).all() and np.isfinite(plan.position_error).all())
