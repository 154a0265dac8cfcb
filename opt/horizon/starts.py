"""Where the search starts: straight joint-space moves that end at the target, and greedy marches.

A descent finds the nearest minimum, so what decides is where it starts. A joint goal whose straight move ends
at the target, the base reacting, gives a start that arrives; goals from all over give the ways round
that a single start would not see. A greedy march is free of cost wherever nothing stops it, and may
arrive where no straight move does.
"""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.horizon.control_qp import braking
from ffsms_pin.opt.horizon.spline import RateSpline
from ffsms_pin.opt.problem import Problem

__all__ = [
    "halton",
    "joint_range",
    "spread_postures",
    "straight_moves",
    "straight_time",
]

_TURN = np.pi  # [rad or m] a joint without a limit is tried this far to each side of the start
_SHARE = 0.9  # of the joint range


def halton(first: int, count: int, dimensions: int) -> FloatArray:
    """Evenly spread points (count, dimensions) in the unit cube, the same in every run.

    Reference: J. H. Halton, "On the efficiency of certain quasi-random sequences of points", 1960.
    """
    primes: list[int] = []
    candidate = 2
    while len(primes) < dimensions:
        if all(candidate % p for p in primes):
            primes.append(candidate)
        candidate += 1
    out = np.zeros((count, dimensions))
    for j, base in enumerate(primes):
        index, fraction = np.arange(first + 1, first + count + 1), 1.0 / base
        while index.any():
            out[:, j] += fraction * (index % base)
            index, fraction = index // base, fraction / base
    return out


def spread_postures(problem: Problem, first: int, count: int, radius: float = np.inf) -> FloatArray:
    """Joint positions (count, n), evenly spread over the joint range, or over what lies near the start.

    Joints that carry nothing with a goal, such as those of an idle arm, stay: what a search starts from
    should not swing them. They still move where that holds the base, or where the terms ask for it.

    Parameters
    ----------
    problem : Problem
    first : int
        How many were drawn before.
    count : int
    radius : float
        Largest distance of a joint from where it starts [rad or m].
    """
    low, high = joint_range(problem)
    start = problem.joints0
    low, high = np.maximum(low, start - radius), np.minimum(high, start + radius)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    spread = middle + _SHARE * half * (2.0 * halton(first, count, problem.sms.n) - 1.0)
    carrying = problem.stack.moves_tip > 0.0
    for end in (end for limit in problem.limits for end in limit.ends):
        carrying = carrying | (end.frame.moves > 0.0)
    return np.where(carrying, spread, start)


def joint_range(problem: Problem) -> tuple[FloatArray, FloatArray]:
    """Where goals are looked for: the joint limits, or half a turn to each side where there is none."""
    limits, start = problem.sms.limits, problem.joints0
    low = np.where(np.isfinite(limits.lower), limits.lower, start - _TURN)
    high = np.where(np.isfinite(limits.upper), limits.upper, start + _TURN)
    return np.where(problem.free, low, start), np.where(problem.free, high, start)


def straight_moves(problem: Problem, spline: RateSpline, goals: FloatArray) -> FloatArray:
    """Control points (K, M, n) of straight joint-space moves of least acceleration.

    A joint that the time is too short for goes as far as its rate and acceleration limits let it.
    """
    size = spline.size
    end = spline.position_points.free[-1]
    system = np.block([[spline.squared_acceleration, end[:, None]], [end[None], np.zeros((1, 1))]])
    profile = np.linalg.solve(system, np.append(np.zeros(size), 1.0))[:-1]
    limits = problem.sms.limits
    # An arm that moves at the start first brakes, and goes the rest of the way.
    brake = braking(problem, spline)
    stopped = spline.position_points.of(brake, problem.joint_rates)[-1]
    way = goals - problem.joints0 - stopped
    rate = np.max(np.abs(profile)) * np.abs(way) / limits.velocity
    acceleration = (
        np.max(np.abs(spline.acceleration_points.free @ profile)) * np.abs(way) / limits.acceleration
    )
    way = way / np.maximum(1.0, 1.001 * np.maximum(rate, acceleration))
    return np.asarray(brake + profile[:, None] * way[:, None, :])


def straight_time(problem: Problem, goal: FloatArray) -> float:
    """Least duration of a straight joint-space move from rest to rest [s]."""
    limits, way = problem.sms.limits, np.abs(goal - problem.joints0)
    if np.isinf(limits.acceleration).any():
        return 0.0  # nothing is known of how long a joint without limits needs
    ramp = limits.velocity / limits.acceleration
    cruise = way / limits.velocity + ramp
    return float(
        np.where(way >= limits.velocity * ramp, cruise, 2.0 * np.sqrt(way / limits.acceleration)).max()
    )
