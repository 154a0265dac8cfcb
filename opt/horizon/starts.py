"""Where the descents start: straight joint-space moves that end at the target, and the greedy march.

A descent finds the nearest minimum, so what decides is where it starts. A joint goal whose straight move
ends at the target, the base reacting, gives a start that arrives; a spread of goals gives the ways round
that a single start would not see. The greedy march is free of cost wherever nothing stops it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.horizon.spline import RateSpline
from ffsms_pin.opt.horizon.stacks import exp3, log3
from ffsms_pin.opt.horizon.task import Task
from ffsms_pin.opt.marching import start_sides
from ffsms_pin.opt.step_kinetics import step_kinetics
from ffsms_pin.opt.step_planner import StepPlanner
from ffsms_pin.system.base_motion import advance

__all__ = ["Goals", "greedy_marches", "halton", "shoot", "straight_moves"]

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


def shoot(task: Task, units: FloatArray, iterations: int = 8) -> Goals:
    """Joint goals whose straight moves end near the target: Newton's method through J*.

    Parameters
    ----------
    task : Task
    units : ndarray, shape (K, n)
        Seeds in the unit cube, spread over the joint range.
    iterations : int
    """
    arm, n, count = task.arm, task.arm.n, len(units)
    low, high = joint_range(task)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    goals = middle + _SHARE * half * (2.0 * units - 1.0)
    inset = 0.005 * half
    x, w = np.polynomial.legendre.leggauss(_POINTS)
    fractions = np.append(0.5 * (x + 1.0), 1.0)[:, None]
    for k in range(iterations):
        way = goals - task.joints0
        values = arm.evaluate((task.joints0 + way[:, None] * fractions).reshape(-1, n))
        spin = values.spin.reshape(count, _POINTS + 1, n, 3)[:, :-1]
        turns = exp3((0.5 * w)[:, None] * (way[:, None, None, :] @ spin)[..., 0, :])
        R = turns[:, 0]
        for i in range(1, _POINTS):
            R = R @ turns[:, i]
        tip = (R @ values.rho.reshape(count, _POINTS + 1, 3)[:, -1, :, None])[..., 0]
        error = task.goal - tip
        if task.rotation is not None:
            attitude = R @ values.tip_rotation.reshape(count, _POINTS + 1, 3, 3)[:, -1]
            error = np.hstack([error, log3(task.rotation0.T @ task.rotation @ np.swapaxes(attitude, 1, 2))])
        if k == iterations - 1:
            break
        columns = values.jstar
        if task.rotation is not None:
            columns = np.concatenate([columns, values.spin + values.axes * arm.moves_tip[:, None]], axis=-1)
        J = np.swapaxes(columns.reshape(count, _POINTS + 1, n, -1)[:, -1], 1, 2)
        J = (R[:, None] @ J.reshape(count, -1, 3, n)).reshape(count, -1, n)
        Jt = np.swapaxes(J, 1, 2)
        step = (
            Jt
            @ np.linalg.solve(J @ Jt + _DAMPING * task.length**2 * np.eye(error.shape[1]), error[..., None])
        )[..., 0]
        step *= np.minimum(1.0, _STEP / np.maximum(np.abs(step).max(axis=1), 1e-9))[:, None]
        goals = np.clip(goals + step, low + inset, high - inset)
    return Goals(goals, np.linalg.norm(error, axis=1))


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
    planner = StepPlanner(task.sms, dt, task.kappa, task.clearance, mode)
    planner.reset(side)
    q, rates, cost = task.q0, np.zeros((steps + 1, task.arm.n)), 0.0
    for k in range(steps):
        step = planner.advance(q, rates[k], task.target, task.duration - k * dt, task.rotation)
        cost += step.cost * dt
        if cost > free or not step.solved:
            return None
        rates[k + 1] = step.joint_rates
        q, _ = advance(task.sms, q, rates[k], (rates[k + 1] - rates[k]) / dt, dt)
    end = step_kinetics(task.sms, q).position
    return rates if float(np.linalg.norm(end - task.target)) <= _MARCH_NEAR * task.length else None
