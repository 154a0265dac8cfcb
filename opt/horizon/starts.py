"""Where the search starts: straight joint-space moves that end at the target, and greedy marches.

A descent finds the nearest minimum, so what decides is where it starts. A joint goal whose straight move ends
at the target, the base reacting, gives a start that arrives; goals from all over give the ways round
that a single start would not see. A goal with an approach is entered from one side, and a descent does not
find the way round from the other; so such a goal gets moves that pass its approach. A greedy march of the
paper's step is free of cost wherever nothing stops it, and may arrive where no straight move does: it is
taken on the cost's cone without limits, all sides at once, by one damped least-squares solution a step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.goals import Place
from ffsms_pin.opt.horizon.control_qp import braking
from ffsms_pin.opt.horizon.options import SearchOptions
from ffsms_pin.opt.horizon.shooting import GoalFromStart, joint_range
from ffsms_pin.opt.horizon.spline import RateSpline
from ffsms_pin.opt.motion.frame import RobotFrame
from ffsms_pin.opt.motion.motions import apply_rates
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.step.march import sides_across
from ffsms_pin.opt.step.reference import ARRIVAL_POWER, LEAST_APPROACH
from ffsms_pin.system.batch.stacks import exp3

__all__ = ["cone_marches", "march_starts", "missed_at", "moves_to", "straight_moves"]

_DAMPING = 1e-3  # of the least squares, in squares of the arm's length
# [arm lengths] What a radian counts on the way: an arm that is stretched out at the goal may not be able to
# keep its attitude and go back from there.
_TURN = 0.1


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


class _Postures(NamedTuple):
    """Joint positions (K, n), and attitudes of the base (3, 3, K)."""

    joints: FloatArray
    base: FloatArray


def moves_to(problem: Problem, spline: RateSpline, goals: FloatArray) -> FloatArray:
    """Control points (K, M, n) of moves to joint goals (K, n): straight, or by way of the goal's approach."""
    approach = problem.goal.approach(problem.duration)
    if not approach or not len(goals):
        return straight_moves(problem, spline, goals)
    from scipy.interpolate import CubicHermiteSpline  # slow to load

    end, arm = problem.goal.place(problem.duration), problem.stack.evaluate(goals.T)
    velocity, spin = (np.zeros(3) if one is None else one for one in (end.velocity, end.spin))
    # The base as it is turned where the tip is at the goal.
    at = _Postures(goals, end.base_attitude(arm.tip_rotation))
    J = missed_at(problem, end, problem.duration, *at)[1]
    rates = [_least_squares(J, np.concatenate([velocity - problem.drift, spin]), problem)]
    times, places = [problem.duration], [goals]
    for t, place in reversed(approach):
        at = _back(problem, at, t, place)
        times.insert(0, t)
        places.insert(0, at.joints)
    for i in range(len(approach) - 1, -1, -1):
        before = max(i - 1, 0)
        rates.insert(0, (places[i + 1] - places[before]) / (times[i + 1] - times[before]))
    times.insert(0, 0.0)
    places.insert(0, np.broadcast_to(problem.joints0, goals.shape))
    rates.insert(0, np.broadcast_to(problem.joint_rates, goals.shape))

    instants = (np.arange(60) + 0.5) * problem.duration / 60
    wanted = CubicHermiteSpline(times, places, rates)(instants, 1)
    return _fitted(problem, spline, instants, np.swapaxes(wanted, 0, 1))


def missed_at(
    problem: Problem, place: Place, t: float, joints: FloatArray, base: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """What postures (K, n) on bases in attitudes (3, 3, K) miss of a place at t [s], (K, 6).

    And how fast the joints make it up, the base reacting, (K, 6, n).
    """
    centre = problem.com0 + t * problem.drift
    wanted = GoalFromStart(place.transformed(-centre, np.eye(3)), RobotFrame.tip(problem.stack))
    error, columns = wanted.missed(problem.stack.evaluate(joints.T), base)
    return error.T, columns.transpose(2, 0, 1) * problem.free


def _back(problem: Problem, at: _Postures, t: float, place: Place) -> _Postures:
    """From postures to those with the end effector at a place: Newton's method, the base reacting."""
    joints, base = at
    low, high = problem.sms.limits.lower, problem.sms.limits.upper
    stuck = np.zeros(joints.shape, dtype=bool)
    for _ in range(6):
        missed, J = missed_at(problem, place, t, joints, base)
        weights = np.repeat([1.0, _TURN * problem.stack.length], [3, missed.shape[1] - 3])
        step = _least_squares(weights[:, None] * J * ~stuck[:, None], weights * missed, problem)
        step *= np.minimum(1.0, 0.2 / np.maximum(np.abs(step).max(axis=1), 1e-9))[:, None]
        wanted = joints + step
        stuck = (wanted < low) | (wanted > high)
        step = np.clip(wanted, low, high) - joints
        spin = problem.stack.evaluate(joints.T).spin
        base = np.einsum("xyk,yzk->xzk", base, exp3(apply_rates(spin, step.T)))
        joints = joints + step
    return _Postures(joints, base)


def _least_squares(J: FloatArray, wanted: FloatArray, problem: Problem) -> FloatArray:
    """Least joint motion (K, n) with J u near to `wanted`, (m,) or (K, m)."""
    rows = J.shape[1]
    square = J @ np.swapaxes(J, 1, 2) + _DAMPING * problem.stack.length**2 * np.eye(rows)
    solved = np.linalg.solve(square, np.broadcast_to(wanted[..., None], (len(J), rows, 1)))
    return np.asarray((np.swapaxes(J, 1, 2) @ solved)[..., 0])


def march_starts(problem: Problem, spline: RateSpline, options: SearchOptions) -> FloatArray:
    """Control points (S, M, n) nearest to the marches."""
    rates = cone_marches(problem, options.march_steps)
    middles = (np.arange(options.march_steps) + 0.5) * problem.duration / options.march_steps
    return _fitted(problem, spline, middles, rates)


def cone_marches(problem: Problem, steps: int) -> FloatArray:
    """Joint rates (S, steps, n) in the middles of steps: a march for each side of the cone, one straight.

    They are starts: a place that rides on the base, or is free about an axis, counts as seen from the start.
    """
    place = problem.goal.place(problem.duration).aim(problem.sms, problem.q0)
    low, high = joint_range(problem)
    most = np.where(problem.free, 0.8 * np.minimum(problem.sms.limits.velocity, 1e6), 0.0)
    J = problem.rotation0 @ problem.arm0.jstar[..., 0]
    sides = np.array([*sides_across(place.position - problem.tip0, J), np.zeros(3)])
    return kernel.cone_marches(
        problem.stack.tree,
        steps,
        problem.duration,
        problem.kappa,
        problem.mean_speed,
        ARRIVAL_POWER,
        LEAST_APPROACH,
        0.003 * problem.stack.length,
        np.stack([problem.joints0, low, high, most]),
        np.stack([place.position, problem.com0, problem.drift]),
        problem.rotation0,
        place.rotation,
        sides,
    )


def _fitted(problem: Problem, spline: RateSpline, times: FloatArray, rates: FloatArray) -> FloatArray:
    """Control points (K, M, n) of the motions nearest to joint rates (K, T, n) at times (T,)."""
    maps = spline.rates_at(times)
    return np.asarray(np.linalg.pinv(maps.free) @ (rates - maps.fixed[:, None] * problem.joint_rates))
