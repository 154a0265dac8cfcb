"""`solve`: from a problem to a trajectory; and `shortest`, by bisection of the duration."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ffsms_pin.checks import instance, optional_callable, positive
from ffsms_pin.errors import InvalidValue, PartError, numerical_errors
from ffsms_pin.opt.horizon.diagnosis import (
    explain,
    noted,
    refused,
    with_limits_said,
    within_workspace,
)
from ffsms_pin.opt.horizon.search import Search, SearchOptions
from ffsms_pin.opt.horizon.shooting import least_time
from ffsms_pin.opt.horizon.strategies import QUICK, STRATEGIES, reaches
from ffsms_pin.opt.parts.reading import NUMERICAL
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.trajectory import Trajectory, measure
from ffsms_pin.threads import one_blas_thread


@numerical_errors("the plan")
@one_blas_thread()
def solve(
    problem: Problem,
    options: SearchOptions | None = None,
    progress: Callable[[float], None] | None = None,
) -> Trajectory:
    """Plan the whole motion at once.

    Of the motions found that arrive and cost no more than the cheapest and a tolerance, the one of least
    effort is the plan (docs/horizon.md). A numerical failure inside is a plan with a `note`.

    Parameters
    ----------
    progress : callable, optional
        Called with the share of the work done, 0 to 1.

    Raises
    ------
    InvalidValue
        The start overlaps an obstacle, or the target lies inside one.
    """
    instance("problem", problem, Problem)
    instance("options", options, SearchOptions, optional=True)
    optional_callable("progress", progress)
    if (stays := refused(problem)) is not None:
        return stays

    def again(other: Problem) -> Trajectory:
        return Search(other, options).run(QUICK)

    search = Search(problem, options, progress)
    try:
        plan = search.run(STRATEGIES)
        if not _finite(plan):
            raise FloatingPointError("the motion found is not a number")
        if not plan.reached and within_workspace(problem):
            plan = with_limits_said(problem, plan, again)
        if not (plan.reached and plan.within_tolerance):
            best = search.best()
            binding = best.model.qp.active(best.p)
            plan = explain(
                problem, plan, search.goals, binding, lambda other, joints: reaches(other, options, joints)
            )
    except (*NUMERICAL, PartError) as error:
        if isinstance(error, PartError) and not isinstance(error.__cause__, NUMERICAL):
            raise  # a mistake in a part
        plan = _before_failure(search, error)
    return noted(plan, plan.note, _momentum_note(problem))


@numerical_errors("the search for the shortest plan")
def shortest(problem: Problem, tolerance: float = 0.05, options: SearchOptions | None = None) -> Trajectory:
    """The plan of least duration that the search finds, by bisection from that of the problem.

    Parameters
    ----------
    tolerance : float
        How near a duration that does and one for which no plan was found shall be, relative, below one. That
        is an upper bound of the least duration, for a search may miss a plan.
    options : SearchOptions, optional
        Of every trial.

    Returns
    -------
    Trajectory
        `shortest_duration` is its duration [s]; `note` begins with the note of that plan, then says in which
        duration none was found and what the joints' limits allow. If the problem fails, and so does what its
        diagnosis proposes: that failed plan.
    """
    instance("problem", problem, Problem)
    if positive("tolerance", tolerance) >= 1.0:
        raise InvalidValue("tolerance", tolerance, "must be below one")
    best = solve(problem, options)
    if not best.reached and best.shortest_duration > 0.0:
        best = solve(problem.lasting(best.shortest_duration), options)
    if not best.reached:
        return best
    failed = 0.0
    for _ in range(20):
        if failed and best.duration <= (1.0 + tolerance) * failed:
            break
        trial = float(np.sqrt(failed * best.duration)) if failed else best.duration / 1.5
        plan = Search(problem.lasting(trial), options).run(QUICK)
        if plan.reached:
            best = plan
        else:
            failed = trial
    way = best.joint_positions[-1] - best.joint_positions[0]
    bound = least_time(problem.sms.limits, way, best.joint_rates[0], best.joint_rates[-1])
    note = (
        f"the shortest motion found; none was found in {failed:.3g} s, and to the posture in which it ends "
        f"the joints' rates and accelerations alone take {bound:.3g} s"
    )
    return noted(best, best.note, note, shortest_duration=best.duration)


def _momentum_note(problem: Problem) -> str:
    """How far the problem's momentum is from the one that its goal asks for; empty where it is that."""
    asked = problem.asked_momentum
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


def _before_failure(search: Search, error: Exception) -> Trajectory:
    """The best motion found before the numbers failed; without any, the arm stays where it is."""
    problem, found = search.problem, [one for one in search.found if _finite(one.plan)]
    if found:
        plan, words = search.best(found).plan, "this is the best motion found before"
    else:
        plan = measure(problem, np.zeros((problem.steps + 1, problem.sms.n)))
        words = "the arm stays where it is"
    note = f"the search ended in a numerical failure ({error}): {words}"
    return noted(plan, note, plan.note)


def _finite(plan: Trajectory) -> bool:
    return bool(np.isfinite(plan.q).all() and np.isfinite(plan.position_error).all())
