"""Where the search starts: straight joint-space moves that end at the target, and greedy marches.

A descent finds the nearest minimum, so what decides is where it starts. A joint goal whose straight move
ends at the target, the base reacting, gives a start that arrives; a spread_postures of goals gives the ways
round that a single start would not see. A greedy march is free of cost wherever nothing stops it, and may
arrive where no straight move does.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.batch.motions import apply_rates
from ffsms_pin.opt.batch.robot_frame import RobotFrame
from ffsms_pin.opt.horizon.control_qp import braking
from ffsms_pin.opt.horizon.spline import RateSpline
from ffsms_pin.opt.limits import BaseLimits
from ffsms_pin.opt.problem import Problem
from ffsms_pin.system.batch.arm import ArmStack, ArmValues
from ffsms_pin.system.batch.stacks import apply, cross, dot, exp3, log3, products

__all__ = [
    "GoalFromStart",
    "JointGoals",
    "halton",
    "joint_goals",
    "joint_range",
    "spread_postures",
    "straight_moves",
    "straight_time",
    "too_short",
]

_POINTS = 4  # Gauss points along a straight move; its base rotation is then known to 1e-4 rad
_TURN = np.pi  # [rad or m] a joint without a limit is tried this far to each side of the start
_SHARE = 0.9  # of the joint range
_STEP = 0.5  # [rad or m] largest Newton step of a joint
_DAMPING = 1e-3  # of the Newton step, for near-singular goals, in squares of the arm's length
# [arm lengths] From here on the damping decreases; a move that ends nearer than the other one ends there.
_FAR, _THERE = 0.1, 1e-3
_NEAR = 0.05  # [arm lengths] moves that end so near end nearly at the target
_ENOUGH = 5  # Newton steps, where most moves end there after them
_QUICKER = 1.5  # times as quick as the quickest straight move known: no plan has been found to be


class JointGoals(NamedTuple):
    """Joint goals (K, n) of straight moves, and how far from the target these end (K,) [m].

    Where an attitude is wanted, a radian counts like a metre; what other frames miss counts too.
    """

    joints: FloatArray
    distance: FloatArray


def halton(first: int, count: int, dimensions: int) -> FloatArray:
    """Evenly spread_postures points (count, dimensions) in the unit cube, the same in every run.

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


class GoalFromStart(NamedTuple):
    """A place for a motion without momentum, from the centre of mass, base axes of the start.

    Attributes
    ----------
    position : ndarray, shape (3,)
        [m]
    rotation : ndarray, shape (3, 3), or None
    frame : RobotFrame or None
        Whose place it is; None: the end effector's.
    """

    position: FloatArray
    rotation: FloatArray | None
    frame: RobotFrame | None = None

    @classmethod
    def all_of(cls, problem: Problem) -> list[GoalFromStart]:
        """The problem's goal, and the ends that its limits ask for.

        With momentum, turned back by about as much as the momentum turns the base.
        """
        place, turn = problem.goal.place(problem.duration), problem.rotation0
        if problem.momentum is not None:
            turn = turn @ exp3(
                problem.duration * (problem.arm0.inverse[..., 0] @ (turn.T @ problem.momentum[3:]))
            )
        origin = problem.com0 + problem.duration * problem.drift
        ends = [end for limit in problem.limits for end in limit.ends()]
        wanted: list[tuple[FloatArray, FloatArray | None, RobotFrame | None]]
        wanted = [(place.position, place.rotation, None)]
        wanted += [(end.position, end.rotation, end.frame) for end in ends]
        return [
            cls(turn.T @ (position - origin), None if rotation is None else turn.T @ rotation, frame)
            for position, rotation, frame in wanted
        ]

    def missed(self, stack: ArmStack, arm: ArmValues, R: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What K motions miss at their end (3 or 6, K), and how fast joints make it up (3 or 6, n, K).

        Parameters
        ----------
        stack : ArmStack
        arm : ArmValues
            At the end.
        R : ndarray, shape (3, 3, K)
            How the base is turned by then.
        """
        if self.frame is None:
            rho, rotation = arm.rho, arm.tip_rotation
            linear, angular = arm.jstar, arm.spin + arm.axes * stack.moves_tip[:, None]
        else:
            seen = self.frame.of_arm(arm)
            rho, rotation = seen.position - arm.com, seen.rotation
            linear = arm.root + cross(arm.spin, seen.position[:, None]) + seen.linear
            angular = arm.spin + seen.angular
        error, columns = self.position[:, None] - apply(R, rho), apply(R, linear)
        if self.rotation is not None:
            turned = log3(np.einsum("xy,zyk->xzk", self.rotation, apply(R, rotation)))
            error = np.concatenate([error, turned])
            columns = np.concatenate([columns, apply(R, angular)])
        return error, columns


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
    for end in (end for limit in problem.limits for end in limit.ends()):
        carrying = carrying | (end.frame.moves > 0.0)
    return np.where(carrying, spread, start)


def joint_goals(problem: Problem, joints: FloatArray, iterations: int = 20) -> JointGoals:
    """Joint goals whose straight moves end near the goal: Newton's method through J*.

    Parameters
    ----------
    problem : Problem
    joints : ndarray, shape (K, n)
        Joint positions to start from.
    iterations : int
        At most; fewer where half of the moves end at the goal before.
    """
    arm, wanted, start = problem.stack, GoalFromStart.all_of(problem), problem.joints0
    low, high = joint_range(problem)
    inset = np.where(problem.free, 0.0025 * (high - low), 0.0)
    goals = np.where(problem.free, joints, start)
    # Of the moves that arrive, rather those that leave the base as it was.
    steady = any(isinstance(one, BaseLimits) and one.holds_attitude for one in problem.limits)
    x, w = np.polynomial.legendre.leggauss(_POINTS)
    fractions = np.append(0.5 * (x + 1.0), 1.0)
    for k in range(iterations):
        way = (goals - start).T[..., None]
        values = arm.evaluate(start[:, None, None] + way * fractions)
        R = products(exp3(0.5 * w * apply_rates(values.spin[..., :-1], way)))[..., -1]
        end = ArmValues(*(value[..., -1] for value in values.arrays()))
        missed = [one.missed(arm, end, R) for one in wanted]
        error = np.concatenate([one for one, _ in missed])
        columns = np.concatenate([one for _, one in missed])
        distance = np.sqrt(dot(error, error))
        if steady:
            error = np.concatenate([error, -log3(R)])
            columns = np.concatenate([columns, apply(R, end.spin)])
        if k == iterations - 1 or (k >= _ENOUGH and np.median(distance) < _THERE * arm.length):
            break
        J = columns.transpose(2, 0, 1) * problem.free
        Jt = np.swapaxes(J, 1, 2)
        # Less damping the nearer: it converges fast, and an end that is nearly singular is met too.
        near = np.clip(np.sqrt(dot(error, error)) / (_FAR * arm.length), 1e-4, 1.0)
        damping = _DAMPING * (arm.length * near) ** 2
        damped = J @ Jt + damping[:, None, None] * np.eye(len(error))
        step = (Jt @ np.linalg.solve(damped, error.T[..., None]))[..., 0]
        step *= np.minimum(1.0, _STEP / np.maximum(np.abs(step).max(axis=1), 1e-9))[:, None]
        goals = np.clip(goals + step, low + inset, high - inset)
    return JointGoals(goals, distance)


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


def too_short(problem: Problem, goals: JointGoals) -> float:
    """A duration [s] in which no motion to these joint goals is worth a search; 0 where none is known.

    Of goals whose straight moves end near the target, the joints need `straight_time` for the quickest.
    """
    still = problem.momentum is None and not problem.joint_rates.any() and not problem.goal.moves
    near = goals.distance <= _NEAR * problem.stack.length
    if not still or not near.any():
        return 0.0
    return min(straight_time(problem, joints) for joints in goals.joints[near]) / _QUICKER
