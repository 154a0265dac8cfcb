"""`solve`: from a problem to a trajectory; and `shortest`, by bisection of the duration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ffsms_pin.checks import instance, optional_callable, positive
from ffsms_pin.errors import InvalidValue, PartError
from ffsms_pin.opt.horizon.diagnosis import explain, with_limits_said, within_workspace
from ffsms_pin.opt.horizon.search import Search, SearchOptions
from ffsms_pin.opt.horizon.strategies import QUICK, STRATEGIES
from ffsms_pin.opt.motion.rollout import rolled_out
from ffsms_pin.opt.parts.reading import violation_of
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.trajectory import Trajectory, measure
from ffsms_pin.system import JointLimits
from ffsms_pin.threads import one_blas_thread

__all__ = ["least_joint_time", "refused", "shortest", "solve"]

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
        `note` says what stood in the way. A numerical failure inside is a plan with a note, too.

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


def shortest(problem: Problem, tolerance: float = 0.05, options: SearchOptions | None = None) -> Trajectory:
    """The plan of least duration that the search finds.

    Durations are bracketed from the problem's own downwards and then halved (in ratio) until one that does
    is within the tolerance of one for which no plan was found. A plan that the search misses is not counted,
    and a moving goal may be met again at an earlier time beyond a gap; so the duration is an upper bound of
    the least. The lower bound beside it is `least_joint_time` to the posture in which the plan ends.

    Parameters
    ----------
    problem : Problem
        Its duration is where the search begins.
    tolerance : float
        Relative, of the duration; above zero and below one.
    options : SearchOptions, optional
        Of every trial.

    Returns
    -------
    Trajectory
        `shortest_duration` is its duration [s]; `note` says between which durations the least one lies and
        what the joints' limits allow. Where the problem itself, and what its diagnosis proposes, fails: that
        failed plan.
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
        bound = least_joint_time(best, problem.sms.limits)
        if failed and best.duration <= (1.0 + tolerance) * failed:
            break
        trial = float(np.sqrt(failed * best.duration)) if failed else best.duration / 1.5
        plan = Search(problem.lasting(trial), options).run(QUICK)
        if plan.reached:
            best = plan
        else:
            failed = trial
    note = (
        f"the shortest motion found; none was found in {failed:.3g} s, and to the posture in which it ends "
        f"the joints' rates and accelerations alone take {bound:.3g} s"
    )
    return replace(best, note=note, shortest_duration=best.duration)


def least_joint_time(plan: Trajectory, limits: JointLimits) -> float:
    """Least time [s] in which the joints can go from a plan's first state to its last one.

    Each joint by itself, under its rate and acceleration limits; the slowest decides. The base and all other
    limits are left out, so no motion to that posture is shorter.
    """
    start, end = plan.joint_rates[0], plan.joint_rates[-1]
    way = plan.joint_positions[-1] - plan.joint_positions[0]
    each = zip(way, start, end, limits.velocity, limits.acceleration, strict=True)
    return max(_one_joint(*(float(value) for value in one)) for one in each)


def _one_joint(way: float, u0: float, u1: float, most: float, a: float) -> float:
    """Of a double integrator: up to a peak rate and down, one way round or the other."""
    if np.isinf(a):
        return abs(way) / most if np.isfinite(most) else 0.0
    # While the rate goes straight from u0 to u1 the joint covers this; what is left decides the sense.
    ramp = 0.5 * (u0 + u1) * abs(u1 - u0) / a
    sense = 1.0 if way >= ramp else -1.0
    way, u0, u1 = sense * way, sense * u0, sense * u1
    peak = min(float(np.sqrt(max(a * way + 0.5 * (u0**2 + u1**2), 0.0))), most)
    peak = max(peak, u0, u1)
    covered = (2.0 * peak**2 - u0**2 - u1**2) / (2.0 * a)
    cruise = max(way - covered, 0.0) / peak if peak > 0.0 else 0.0
    return (2.0 * peak - u0 - u1) / a + cruise


def refused(problem: Problem) -> Trajectory | None:
    """A plan that stays where it is, where no motion from this start keeps the limits.

    Raises
    ------
    InvalidValue
        The start overlaps an obstacle, or the target lies inside one.
    """
    still = np.zeros((problem.steps + 1, problem.sms.n))
    begin = rolled_out(problem.sms, problem.stack, problem.q0, still[:2], problem.dt)
    found = [(limit, violation_of(limit, begin)) for limit in problem.limits if limit.refusal]
    for _, one in found:
        if one.overlap:
            raise InvalidValue(
                "q0",
                problem.joints0.round(6),
                f"must keep clear of obstacles: {one.overlap} at the start; move the start or the obstacle",
            )
    _check_target(problem)
    notes = [limit.refusal.format(note=one.note) for limit, one in found if one.amount > 0.0]
    if not notes:
        return None
    return replace(measure(problem, still), clear=False, note="; ".join(notes))


def _check_target(problem: Problem) -> None:
    """Raise where the target lies inside an obstacle at the deadline."""
    place = problem.goal.place(problem.duration)
    for began, obstacle in ((held.began, one) for held in problem.limits for one in held.obstacles):
        if obstacle.on_base or place.moves_with_base:
            continue  # where the base will be is not known
        depth = -obstacle.distance(place.position, began + problem.duration)
        if depth > problem.goal.tolerance:
            raise InvalidValue(
                "target",
                place.position,
                f"must lie outside obstacles: it is {1e3 * depth:.1f} mm inside '{obstacle.name}'; move "
                "the target or the obstacle",
            )


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
