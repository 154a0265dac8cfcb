"""Where the search starts: straight joint-space moves that end at the target, and greedy marches.

A descent finds the nearest minimum, so what decides is where it starts. A joint goal whose straight move
ends at the target, the base reacting, gives a start that arrives; a spread of goals gives the ways round
that a single start would not see. A greedy march is free of cost wherever nothing stops it, and may arrive
where no straight move does.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.horizon.course import apply_rates
from ffsms_pin.opt.horizon.spline import RateSpline
from ffsms_pin.opt.batch.stacks import apply, dot, exp3, log3, products
from ffsms_pin.opt.horizon.task import Task
from ffsms_pin.opt.marching import start_sides
from ffsms_pin.opt.step_kinetics import step_kinetics
from ffsms_pin.opt.step_planner import StepPlanner
from ffsms_pin.system.base_motion import advance

__all__ = [
    "Goals",
    "greedy_marches",
    "halton",
    "joint_range",
    "seeds",
    "shoot",
    "straight_moves",
    "straight_time",
]

_MARCH_STEPS = 100  # of the coarse march: some 15 ms a side for three joints
# [s], [arm lengths] A coarse march that costs more, or ends further away, is not nearly free on the fine step
# either.
_COARSE_COST = 5e-3
_MARCH_NEAR = 5e-3
_POINTS = 4  # Gauss points along a straight move; its base rotation is then known to 1e-4 rad
_TURN = np.pi  # [rad or m] a joint without a limit is tried this far to each side of the start
_SHARE = 0.9  # of the joint range
_STEP = 0.5  # [rad or m] largest Newton step of a joint
_DAMPING = 1e-3  # of the Newton step, for near-singular goals, in squares of the arm's length
# [arm lengths] From here on the damping decreases; a move that ends nearer than the other one ends there.
_FAR, _THERE = 0.1, 1e-3
_ENOUGH = 5  # Newton steps, where most moves end there after them


class Goals(NamedTuple):
    """Joint goals (K, n) of straight moves, and how far from the target these end (K,) [m].

    Where an attitude is wanted, a radian counts like a metre.
    """

    joints: FloatArray
    distance: FloatArray


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


def shoot(task: Task, units: FloatArray, iterations: int = 20) -> Goals:
    """Joint goals whose straight moves end near the target: Newton's method through J*.

    Parameters
    ----------
    task : Task
    units : ndarray, shape (K, n)
        Seeds in the unit cube, spread over the joint range.
    iterations : int
        At most; fewer where half of the moves end at the target before.
    """
    arm = task.arm
    low, high = joint_range(task)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    goals = middle + _SHARE * half * (2.0 * units - 1.0)
    inset = 0.005 * half
    wanted = None if task.rotation is None else task.rotation0.T @ task.rotation
    if wanted is not None and task.momentum is not None:
        wanted = task.carried.T @ wanted
    # Of the moves that arrive, rather those that leave the base as it was.
    limits = task.base_limits
    steady = limits is not None and min(limits.attitude, limits.final_attitude) < np.inf
    x, w = np.polynomial.legendre.leggauss(_POINTS)
    fractions = np.append(0.5 * (x + 1.0), 1.0)
    for k in range(iterations):
        way = (goals - task.joints0).T[..., None]
        values = arm.evaluate(task.joints0[:, None, None] + way * fractions)
        R = products(exp3(0.5 * w * apply_rates(values.spin[..., :-1], way)))[..., -1]
        error = task.aim[:, None] - apply(R, values.rho[..., -1])
        columns = [values.jstar[..., -1]]
        if wanted is not None:
            attitude = apply(R, values.tip_rotation[..., -1])
            error = np.concatenate([error, log3(np.einsum("xy,zyk->xzk", wanted, attitude))])
            columns.append(values.spin[..., -1] + values.axes[..., -1] * arm.moves_tip[:, None])
        distance = np.sqrt(dot(error, error))
        if steady:
            error = np.concatenate([error, -log3(R)])
            columns.append(values.spin[..., -1])
        if k == iterations - 1 or (k >= _ENOUGH and np.median(distance) < _THERE * task.length):
            break
        J = np.concatenate([apply(R, column) for column in columns]).transpose(2, 0, 1)
        Jt = np.swapaxes(J, 1, 2)
        # Less damping the nearer: it converges fast, and an end that is nearly singular is met too.
        near = np.clip(np.sqrt(dot(error, error)) / (_FAR * task.length), 1e-4, 1.0)
        damping = _DAMPING * (task.length * near) ** 2
        damped = J @ Jt + damping[:, None, None] * np.eye(len(error))
        step = (Jt @ np.linalg.solve(damped, error.T[..., None]))[..., 0]
        step *= np.minimum(1.0, _STEP / np.maximum(np.abs(step).max(axis=1), 1e-9))[:, None]
        goals = np.clip(goals + step, low + inset, high - inset)
    return Goals(goals, distance)


def seeds(task: Task, joints: FloatArray) -> FloatArray:
    """The units from which `shoot` starts at joint positions (K, n)."""
    low, high = joint_range(task)
    return np.asarray(0.5 + (joints - 0.5 * (low + high)) / (_SHARE * (high - low)))


def joint_range(task: Task) -> tuple[FloatArray, FloatArray]:
    """Where goals are looked for: the joint limits, or half a turn to each side where there is none."""
    limits, start = task.sms.limits, task.joints0
    low = np.where(np.isfinite(limits.lower), limits.lower, start - _TURN)
    high = np.where(np.isfinite(limits.upper), limits.upper, start + _TURN)
    return low, high


def straight_moves(task: Task, spline: RateSpline, goals: FloatArray) -> FloatArray:
    """Control points (K, M, n) of straight joint-space moves of least acceleration.

    A joint that the time is too short for goes as far as its rate and acceleration limits let it.
    """
    end, size = spline.position[-1], spline.size
    system = np.block([[spline.roughness, end[:, None]], [end[None], np.zeros((1, 1))]])
    profile = np.linalg.solve(system, np.append(np.zeros(size), 1.0))[:-1]
    limits, way = task.sms.limits, goals - task.joints0
    rate = np.max(np.abs(profile)) * np.abs(way) / limits.velocity
    acceleration = np.max(np.abs(spline.acceleration @ profile)) * np.abs(way) / limits.acceleration
    way = way / np.maximum(1.0, 1.001 * np.maximum(rate, acceleration))
    return np.asarray(profile[:, None] * way[:, None, :])


def greedy_marches(task: Task, free: float) -> Iterator[FloatArray]:
    """Joint rates at the nodes (N + 1, n) of step marches, one a side, that cost less than `free` [s].

    A march on a coarse step tells beforehand which sides are worth a march on the task's own.
    """
    steps = min(task.steps, _MARCH_STEPS)
    for side in start_sides(task.sms, task.q0, task.target):
        if _march(task, steps, side, _COARSE_COST) is not None:
            rates = _march(task, task.steps, side, free)
            if rates is not None:
                yield rates


def _march(task: Task, steps: int, side: FloatArray, free: float) -> FloatArray | None:
    """Joint rates of a march that costs less than `free` and comes near the target; else None."""
    dt, mode = task.duration / steps, "off" if task.clearances is None else task.clearances.mode
    planner = StepPlanner(
        task.sms, dt, task.kappa, task.clearance, mode, base_limits=task.base_limits, momentum=task.momentum
    )
    planner.reset(side)
    q, rates, cost = task.q0, np.zeros((steps + 1, task.arm.n)), 0.0
    for k in range(steps):
        step = planner.advance(q, rates[k], task.target, task.duration - k * dt, task.rotation)
        cost += step.cost * dt
        if cost > free or not step.solved:
            return None
        rates[k + 1] = step.joint_rates
        q, _ = advance(task.sms, q, rates[k], (rates[k + 1] - rates[k]) / dt, dt, task.momentum)
    end = step_kinetics(task.sms, q).position
    return rates if float(np.linalg.norm(end - task.target)) <= _MARCH_NEAR * task.length else None


def straight_time(task: Task, goal: FloatArray) -> float:
    """Least duration of a straight joint-space move from rest to rest [s]."""
    limits, way = task.sms.limits, np.abs(goal - task.joints0)
    if np.isinf(limits.acceleration).any():
        return 0.0  # nothing is known of how long a joint without limits needs
    ramp = limits.velocity / limits.acceleration
    cruise = way / limits.velocity + ramp
    return float(
        np.where(way >= limits.velocity * ramp, cruise, 2.0 * np.sqrt(way / limits.acceleration)).max()
    )
