"""Why a goal that moves is not met, and when to try: where its way is within reach, and how fast it is."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.horizon.shooting import JointGoals
from ffsms_pin.opt.horizon.starts import missed_at
from ffsms_pin.opt.problem import Problem

__all__ = ["later_deadline", "time_within_reach", "too_fast"]

_AHEAD, _LEAST_AHEAD = 10.0, 600.0  # durations, and seconds, that are looked ahead
_TIMES = 3001
_LONGER = (1.5, 2.0)  # times the failed duration: the deadlines that are tried


def time_within_reach(problem: Problem, least: float, most: float) -> str:
    """When the goal is within reach, nearest to the deadline that failed, in words.

    Parameters
    ----------
    problem : Problem
    least, most : float
        How far from the system's centre of mass the end effector can be [m].
    """
    t, inside = _within_reach(problem, least, most)
    if not inside.any():
        return f"the goal is not within reach at any time in the next {t[-1]:.0f} s"
    k = int(np.flatnonzero(inside)[np.argmin(np.abs(t[inside] - problem.duration))])
    outside = np.flatnonzero(~inside)
    first = int(outside[outside < k].max(initial=-1)) + 1
    last = int(outside[outside > k].min(initial=len(t))) - 1
    middle = 0.5 * (t[first] + t[last])
    return (
        f"the goal is within reach from {t[first]:.1f} s to {t[last]:.1f} s: "
        f"the best time to try is a deadline near {middle:.1f} s"
    )


def too_fast(problem: Problem, goals: JointGoals) -> str:
    """What the joints would need to move with the goal at the deadline, where that is beyond their rates."""
    place = problem.goal.place(problem.duration)
    near = goals.joints[goals.distance <= 0.05 * problem.stack.length]
    if place.velocity is None or place.spin is None or not len(near):
        return ""
    base = place.base_attitude(problem.stack.evaluate(near.T).tip_rotation)
    J = missed_at(problem, place, problem.duration, near, base)[1]
    wanted = np.concatenate([place.velocity - problem.drift, place.spin])
    rates = (np.linalg.pinv(J, rcond=1e-3) @ wanted[:, None])[..., 0]
    share = float(np.abs(rates / problem.sms.limits.velocity).max(axis=1).min())
    if share <= 1.0:
        return ""
    return f"too fast: to move with the goal at the deadline takes {share:.1f} times the joints' rate limits"


def later_deadline(problem: Problem, least: float, most: float, attempt: Callable[[Problem], bool]) -> float:
    """A later deadline at which a goal that moves is met [s]; 0: none found."""
    t, inside = _within_reach(problem, least, most)
    for factor in _LONGER:
        duration = factor * problem.duration
        if inside[int(np.argmin(np.abs(t - duration)))] and attempt(problem.lasting(duration)):
            return duration
    return 0.0


def _within_reach(problem: Problem, least: float, most: float) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Times (K,) ahead, and whether the goal is within reach then."""
    t = np.linspace(0.0, max(_AHEAD * problem.duration, _LEAST_AHEAD), _TIMES)[1:]
    way = problem.goal.places(t).position - problem.com0[:, None] - problem.drift[:, None] * t
    distance = np.linalg.norm(way, axis=0)
    return t, (distance >= least) & (distance <= most)
