"""The shortest motion to a goal, by bisection of its duration, beside what the joints' limits allow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ffsms_pin.checks import instance, positive
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.horizon import SearchOptions, solve
from ffsms_pin.opt.horizon.search import Search
from ffsms_pin.opt.horizon.strategies import QUICK
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.trajectory import Trajectory
from ffsms_pin.system import JointLimits

__all__ = ["least_joint_time", "shortest"]

_SHORTER = 1.5  # the first bracket: durations are divided by this until one fails
_MOST_TRIALS = 20


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

    Raises
    ------
    InvalidValue
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
    for _ in range(_MOST_TRIALS):
        bound = least_joint_time(best, problem.sms.limits)
        if failed and best.duration <= (1.0 + tolerance) * failed:
            break
        trial = float(np.sqrt(failed * best.duration)) if failed else best.duration / _SHORTER
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
    times = [
        _one_joint(float(d), float(u0), float(u1), float(most), float(a))
        for d, u0, u1, most, a in zip(way, start, end, limits.velocity, limits.acceleration, strict=True)
    ]
    return max(times)


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
