"""Inverse kinematics with a reacting base: joint goals whose straight joint-space moves end at the target.

Straight moves to joint goals are initial guesses. Joint goals are computed from many postures, near the start
and in the whole joint range, to find motions of different homotopy classes.
"""

from __future__ import annotations

from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.derivatives import FrameVariable, RobotFrame
from ffsms_pin.opt.goals.goal import Place
from ffsms_pin.opt.limits.limit import FrameEnd
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.rollouts import apply_rates, velocity_slopes
from ffsms_pin.opt.search.spline import COARSE, RateSpline, gauss, rate_spline
from ffsms_pin.opt.search.tumbling import tumbling_ends
from ffsms_pin.system import RobotLimits
from ffsms_pin.system.batch.arm import ArmValues
from ffsms_pin.system.batch.stacks import apply, cross, dot, exp3, log3, products

# [rad/s] Largest joint rates at the last node of a motion that ends at rest. They are not zero, because the
# paper's cost includes the direction of motion at this node.
AT_REST = 8e-4


def at_rest(problem: Problem) -> FloatArray:
    """Return the largest joint rates (n,) of an arm at rest at the deadline."""
    return np.minimum(AT_REST, 2e-3 * problem.sms.limits.velocity)  # the second bound is for slow arms


def braking(problem: Problem, spline: RateSpline) -> FloatArray:
    """Return the control points (M, n) of an arm that brakes from its initial rates."""
    rates, limit = problem.joint_rates, problem.sms.limits.acceleration
    slower = np.abs(rates) - spline.sites[:, None] * np.minimum(limit, 1e6)
    return np.asarray(np.sign(rates) * np.maximum(slower, 0.0))


_DAMPING = 1e-3  # [arm lengths squared] damping of least squares with J*, for near-singular goals


class JointGoals(NamedTuple):
    """The joint goals (K, n), and the pose errors `distance` (K,) at the ends of straight moves to them.

    Each error is the root of the sum of squares of all position errors [m] and attitude errors [rad].
    """

    joints: FloatArray
    distance: FloatArray

    def near(self, problem: Problem, radius: float = 0.05) -> FloatArray:
        """Return the goals whose straight moves end within `radius` arm lengths of the target."""
        return self.joints[self.distance <= radius * problem.stack.length]

    def arrived(self, problem: Problem) -> FloatArray:
        """Return the goals whose straight moves end within 1e-3 arm lengths of the target."""
        return self.near(problem, 1e-3)


class _GoalFromStart(NamedTuple):
    """The desired place of a frame at the end of a joint-space move.

    A place that moves with the base is in the base's axes. The origin of any other place is the system's
    centre of mass, and its axes are those of the base at the start, or inertial axes (`pose_error_at`).
    """

    place: Place
    frame: RobotFrame

    def pose_error(
        self, arm: ArmValues, R: FloatArray, path_turning: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return pose errors (3 or 6, K) at the ends of moves, and the slopes (3 or 6, n, K) of the poses.

        The slopes are by joint goals; an error is the desired pose minus the pose. The arguments are the
        results of `straight_ends`.
        """
        position, rotation, linear, angular = self.frame.of_arm(arm)
        if not self.place.moves_with_base:
            linear = apply(R, arm.root + cross(arm.spin, position[:, None]) + linear)
            angular = apply(R, arm.spin + angular)
            position, rotation = apply(R, position - arm.com), apply(R, rotation)
            if path_turning is not None:
                linear = linear + cross(path_turning, position[:, None])
                angular = angular + path_turning
        missed = self.place.pose_error(FrameVariable(position[:, None], rotation[:, :, None], {}, {}))
        error = np.concatenate([part.value[:, 0] for part in missed.parts])
        return error, np.concatenate([linear, self.place.without_free_axis(angular)])


def _goals_from_start(problem: Problem) -> list[_GoalFromStart]:
    """Return the desired places of the problem's goal and of `Limit.ends`."""
    R0 = problem.rotation0
    origin = problem.com0 + problem.duration * problem.drift
    ends = [FrameEnd(RobotFrame.of(problem.stack), problem.place)]
    ends += [end for limit in problem.limits for end in limit.ends]
    return [
        _GoalFromStart(place if place.moves_with_base else place.transformed(-R0.T @ origin, R0.T), frame)
        for frame, place in ends
    ]


def joint_goals(problem: Problem, joints: FloatArray) -> JointGoals:
    """Compute joint goals whose straight moves end near the goal, by Newton's method from postures (K, n).

    The iteration ends early if half of the moves end within 1e-3 arm lengths of the goal. The slopes of
    Newton's method follow from J* at the end of the move. If the base rotates far, the slopes include the
    change of the base's rotation along the move (`straight_ends`). With angular momentum the moves are rolled
    out in time.
    """
    arm, places, start, iterations = problem.stack, _goals_from_start(problem), problem.joints0, 20
    low, high = joint_range(problem)
    inset = np.where(problem.free, 0.0025 * (high - low), 0.0)
    # [rad or m] The largest step of a joint. Slopes are exact if the median base rotation exceeds this value.
    large = 0.5
    goals = np.where(problem.free, joints, start)
    # With a limit on the base's attitude, moves with little base rotation are preferred. In re-planning they
    # are not preferred, because the base has already rotated.
    steady = problem.base_start is None and any(limit.holds_attitude for limit in problem.limits)
    exact = False
    path_turning: FloatArray | None
    for k in range(iterations):
        if problem.tumbles:
            end, R, path_turning = _tumbling_straight_ends(problem, goals)
        else:
            end, R, path_turning = straight_ends(problem, goals, exact)
        exact = exact or (k == 0 and float(np.median(np.linalg.norm(log3(R), axis=0))) > large)
        missed = [place.pose_error(end, R, path_turning) for place in places]
        error, columns = (np.concatenate(parts) for parts in zip(*missed, strict=True))
        distance = np.sqrt(dot(error, error))
        if steady:
            error = np.concatenate([error, -log3(R)])
            turning = apply(R, end.spin)
            columns = np.concatenate([columns, turning if path_turning is None else turning + path_turning])
        if k == iterations - 1 or (k >= 5 and np.median(distance) < 1e-3 * arm.length):
            break
        J = columns.transpose(2, 0, 1) * problem.free
        # At less than a tenth of the arm's length from the target the damping is reduced. Moves to nearly
        # singular postures then converge fast, too.
        near = np.clip(np.sqrt(dot(error, error)) / (0.1 * arm.length), 1e-4, 1.0)
        step = least_squares(J, error.T, _DAMPING * (arm.length * near)[:, None, None] ** 2)
        step *= np.minimum(1.0, large / np.maximum(np.abs(step).max(axis=1), 1e-9))[:, None]
        goals = np.clip(goals + step, low + inset, high - inset)
    return JointGoals(goals, distance)


def least_squares(J: FloatArray, values: FloatArray, damping: float | FloatArray) -> FloatArray:
    """Return the damped least-squares solutions u (K, n) of J u = values, with values (m,) or (K, m)."""
    rows, Jt = J.shape[1], np.swapaxes(J, 1, 2)
    values = np.broadcast_to(values[..., None], (len(J), rows, 1))
    return np.asarray((Jt @ np.linalg.solve(J @ Jt + damping * np.eye(rows), values))[..., 0])


def straight_ends(
    problem: Problem, goals: FloatArray, exact: bool = False
) -> tuple[ArmValues, FloatArray, FloatArray | None]:
    """Return the ends of straight moves to joint goals (K, n) without momentum.

    The results are the arm at the end in base axes, and, in the base's axes at the start, the base's rotation
    (3, 3, K) and a correction of slopes (3, n, K). Without `exact` the correction is None. It is the slope of
    the base's rotation by the joint goals, minus the base's angular velocity per joint rate at the end. The
    correction is not zero, because another joint goal changes the whole move.
    """
    stack, start = problem.stack, problem.joints0
    # With four instants the error of a small base rotation is 1e-4 rad.
    s, weights = gauss(12 if exact else 4)
    displacement = (goals - start).T[..., None]
    values = stack.evaluate(start[:, None, None] + displacement * np.append(s, 1.0))
    turns = weights * apply_rates(values.spin[..., :-1], displacement)
    after = products(exp3(turns))
    R, arm = after[..., -1], ArmValues(*(value[..., -1] for value in values.arrays()))
    if not exact:
        return arm, R, None
    at = ArmValues(*(value[..., :-1] for value in values.arrays()))
    slopes, _ = velocity_slopes(stack, at, np.broadcast_to(displacement, (*displacement.shape[:2], len(s))))
    there = apply(after, exp3(-0.5 * turns))
    turning = np.einsum("g,xjkg->xjk", weights, apply(there, at.spin + s * slopes))
    return arm, R, turning - apply(R, arm.spin)


def _tumbling_straight_ends(problem: Problem, goals: FloatArray) -> tuple[ArmValues, FloatArray, FloatArray]:
    """Return the results of `straight_ends(exact=True)` for a robot with angular momentum.

    The moves have the time law of `straight_moves`.
    """
    spline = rate_spline(problem.steps, problem.dt, COARSE, not problem.place.rests)
    profile, brake = straight_profile(spline), braking(problem, spline)
    share, speed = spline.travel.free @ profile, spline.rates.free @ profile
    travel_left = (goals - problem.joints0 - spline.position_points.of(brake, problem.joint_rates)[-1]).T[
        ..., None
    ]
    maps = (spline.travel, spline.rates)
    travel, rates = (mapping.of(brake, problem.joint_rates).T[:, None] for mapping in maps)
    joints = problem.joints0[:, None, None] + travel + share * travel_left
    arm, R, turning = tumbling_ends(problem, spline, joints, rates + speed * travel_left, share, speed)
    return arm, R, turning - apply(R, arm.spin)


def halton(first: int, count: int, dimensions: int) -> FloatArray:
    """Return `count` points (count, dimensions) of the Halton sequence in the unit cube, from index `first`.

    Reference: J. H. Halton, "On the efficiency of certain quasi-random sequences of points", 1960.
    """
    # The nth prime is below n (log n + log log n) for n > 5.
    numbers = range(2, 13 + int(dimensions * 2.0 * np.log(dimensions + 1.0)))
    primes = [number for number in numbers if all(number % p for p in range(2, number))]
    out = np.zeros((count, dimensions))
    for j, base in enumerate(primes[:dimensions]):
        index, fraction = np.arange(first + 1, first + count + 1), 1.0 / base
        while index.any():
            out[:, j] += fraction * (index % base)
            index, fraction = index // base, fraction / base
    return out


def spread_postures(problem: Problem, first: int, count: int, radius: float = np.inf) -> FloatArray:
    """Return joint positions (count, n), evenly spread in `joint_range` within a radius of the start.

    The radius is in rad or m. `first` is the index of the first posture in the sequence of postures. Joints
    that move no frame with a goal, for example the joints of a second arm, keep their positions.
    """
    low, high = joint_range(problem)
    start = problem.joints0
    low, high = np.maximum(low, start - radius), np.minimum(high, start + radius)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    spread = middle + 0.9 * half * (2.0 * halton(first, count, problem.sms.n) - 1.0)
    moved = [problem.stack.moves_tip, *(end.frame.moves for limit in problem.limits for end in limit.ends)]
    return np.where(np.any(np.array(moved) > 0.0, axis=0), spread, start)


def joint_range(problem: Problem) -> tuple[FloatArray, FloatArray]:
    """Return the range of joint goals: the position limits, or start +-pi for joints without limits.

    The range of a locked joint is its position at the start.
    """
    limits, start = problem.sms.limits, problem.joints0
    low = np.where(np.isfinite(limits.lower), limits.lower, start - np.pi)
    high = np.where(np.isfinite(limits.upper), limits.upper, start + np.pi)
    return np.where(problem.free, low, start), np.where(problem.free, high, start)


def straight_time(problem: Problem, goals: FloatArray) -> FloatArray:
    """Return the least times [s] of moves from rest to rest to joint goals (..., n), see `least_time`."""
    return least_time(problem.sms.limits, goals - problem.joints0)


def least_time(limits: RobotLimits, displacement: FloatArray, begin: Any = 0.0, end: Any = 0.0) -> FloatArray:
    """Return the least time [s] for joint displacements (..., n) under limits of rates and accelerations.

    `begin` and `end` are the joint rates at both ends. Each joint is a double integrator, which accelerates
    to a peak rate, keeps this rate if it is the rate limit, and decelerates. The slowest joint determines the
    time.
    """
    a = np.minimum(limits.acceleration, 1e12)
    # `ramp` is the displacement while the rate changes directly from `begin` to `end`. The sign of the
    # remaining displacement is the direction of the motion.
    ramp = 0.5 * (begin + end) * np.abs(end - begin) / a
    sense = np.where(displacement >= ramp, 1.0, -1.0)
    displacement, begin, end = sense * displacement, sense * begin, sense * end
    peak = np.sqrt(np.maximum(a * displacement + 0.5 * (begin**2 + end**2), 0.0))
    peak = np.maximum(np.minimum(peak, limits.velocity), np.maximum(begin, end))
    covered = (2.0 * peak**2 - begin**2 - end**2) / (2.0 * a)
    cruise = np.maximum(displacement - covered, 0.0) / np.maximum(peak, 1e-300)
    return np.asarray(np.max((2.0 * peak - begin - end) / a + cruise, axis=-1))


def straight_profile(spline: RateSpline) -> FloatArray:
    """Return control points (M,) of a joint's move by 1 from rest with least squared acceleration.

    The joint is at rest at the end unless `spline.free_end`.
    """
    end = spline.position_points.free[-1]
    system = np.block([[spline.squared_acceleration, end[:, None]], [end[None], np.zeros((1, 1))]])
    return np.asarray(np.linalg.solve(system, np.append(np.zeros(spline.size), 1.0))[:-1])


def straight_moves(problem: Problem, spline: RateSpline, goals: FloatArray) -> FloatArray:
    """Return control points (K, M, n) of straight moves with `straight_profile` to joint goals (K, n).

    If the duration is too short for a joint, the joint moves as far as its rate and acceleration limits
    allow with this profile.
    """
    profile, limits = straight_profile(spline), problem.sms.limits
    # The motion of a moving arm is the sum of braking and of a move by the remaining displacement.
    brake = braking(problem, spline)
    stopped = spline.position_points.of(brake, problem.joint_rates)[-1]
    displacement = goals - problem.joints0 - stopped
    hardest = np.max(np.abs(spline.acceleration_points.free @ profile))
    rate = np.max(np.abs(profile)) * np.abs(displacement) / limits.velocity
    acceleration = hardest * np.abs(displacement) / limits.acceleration
    displacement = displacement / np.maximum(1.0, 1.001 * np.maximum(rate, acceleration))
    return np.asarray(brake + profile[:, None] * displacement[:, None, :])


def moves_to(problem: Problem, spline: RateSpline, goals: FloatArray) -> FloatArray:
    """Return control points (K, M, n) of moves to joint goals (K, n), straight or along `Goal.approach`."""
    approach = problem.goal.approach(problem.duration)
    if not approach or not len(goals):
        return straight_moves(problem, spline, goals)
    from scipy.interpolate import CubicHermiteSpline  # slow to load

    end, arm = problem.place, problem.stack.evaluate(goals.T)
    velocity, spin = np.split(end.twist, 2)
    # `base` is the base's attitude for which the end effector is at the goal.
    joints, base = goals, end.base_attitude(arm.tip_rotation)
    J = pose_error_at(problem, end, problem.duration, joints, base)[1]
    damping = _DAMPING * problem.stack.length**2
    at_goal = least_squares(J, np.concatenate([velocity - problem.drift, spin]), damping)
    times, places = [0.0, *(t for t, _ in approach), problem.duration], [goals]
    for t, place in reversed(approach):
        joints, base = _back(problem, joints, base, t, place)
        places.insert(0, joints)
    places.insert(0, np.broadcast_to(problem.joints0, goals.shape))
    rates = [np.broadcast_to(problem.joint_rates, goals.shape)]
    for i in range(1, len(places) - 1):
        before = max(i - 1, 1)
        rates.append((places[i + 1] - places[before]) / (times[i + 1] - times[before]))
    rates.append(at_goal)

    instants = (np.arange(60) + 0.5) * problem.duration / 60
    desired = CubicHermiteSpline(times, places, rates)(instants, 1)
    return spline.nearest(instants, np.swapaxes(desired, 0, 1), problem.joint_rates)


def pose_error_at(
    problem: Problem, place: Place, t: float, joints: FloatArray, base: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return pose errors (K, 3 or 6) of postures (K, n) at time `t` [s], and the slopes of the poses.

    An error is the desired place minus the pose of the end effector. The slopes (K, 3 or 6, n) are by joint
    positions, with a reacting base. `base` (3, 3, K) are the base's attitudes.
    """
    centre = problem.com0 + t * problem.drift
    desired = _GoalFromStart(place.transformed(-centre, np.eye(3)), RobotFrame.of(problem.stack))
    error, columns = desired.pose_error(problem.stack.evaluate(joints.T), base)
    return error.T, columns.transpose(2, 0, 1) * problem.free


def _back(
    problem: Problem, joints: FloatArray, base: FloatArray, t: float, place: Place
) -> tuple[FloatArray, FloatArray]:
    """Return postures (K, n) with the end effector close to a place at t [s], and base attitudes (3, 3, K).

    They result from six iterations of Newton's method from the postures `joints`, with a reacting base.
    """
    low, high = problem.sms.limits.lower, problem.sms.limits.upper
    damping, stuck = _DAMPING * problem.stack.length**2, np.zeros(joints.shape, dtype=bool)
    for _ in range(6):
        missed, J = pose_error_at(problem, place, t, joints, base)
        # Rotation has a small weight, because a stretched arm may have to rotate its end effector to retreat.
        weights = np.repeat([1.0, 0.1 * problem.stack.length], [3, missed.shape[1] - 3])
        step = least_squares(weights[:, None] * J * ~stuck[:, None], weights * missed, damping)
        step *= np.minimum(1.0, 0.2 / np.maximum(np.abs(step).max(axis=1), 1e-9))[:, None]
        moved = joints + step
        stuck = (moved < low) | (moved > high)
        step = np.clip(moved, low, high) - joints
        spin = problem.stack.evaluate(joints.T).spin
        base = np.einsum("xyk,yzk->xzk", base, exp3(apply_rates(spin, step.T)))
        joints = joints + step
    return joints, base


_reach_ranges: WeakKeyDictionary[Problem, tuple[float, float]] = WeakKeyDictionary()


def within_workspace(problem: Problem) -> bool:
    """Return whether the target's distance is in the reachable range (`workspace_distances`)."""
    distance, least, most = workspace_distances(problem)
    return bool(least - problem.goal.tolerance <= distance <= most + problem.goal.tolerance)


def workspace_distances(problem: Problem) -> tuple[float, float, float]:
    """Return the target's distance from the centre of mass at the deadline, and the reachable range [m].

    The distance of a goal on the base is unknown; it is set to the middle of the range.
    """
    place, (least, most) = problem.place, reach_range(problem)
    displacement = place.position - problem.com0 - problem.duration * problem.drift
    return 0.5 * (least + most) if place.moves_with_base else float(np.linalg.norm(displacement)), least, most


def reach_range(problem: Problem) -> tuple[float, float]:
    """Return the least and greatest distance [m] of the end effector from the centre of mass.

    The centre of mass is that of the system, or of the base if its position is held. The distances result
    from a search over `joint_range`, and are computed once for each problem.
    """
    reach = _reach_ranges.get(problem)
    if reach is None:
        reach = _reach_ranges[problem] = _searched_reach_range(problem)
    return reach


def _searched_reach_range(problem: Problem) -> tuple[float, float]:
    """Compute the result of `reach_range` by gradient steps from postures spread over the joint range."""
    low, high = joint_range(problem)
    stack, seeds = problem.stack, spread_postures(problem, 0, 64)
    extremes = []
    for sense in (-1.0, 1.0):
        joints: FloatArray = seeds
        best = np.inf
        for k in range(40):
            arm = stack.evaluate(joints.T)
            distance = np.linalg.norm(arm.rho, axis=0)
            best = min(best, float((-sense * distance).min()))
            slope = np.einsum("inb,ib->bn", arm.arm - arm.linear / stack.mass, arm.rho)
            step = sense * slope / np.maximum(np.abs(slope).max(axis=1, keepdims=True), 1e-9)
            joints = np.clip(joints + 0.5 * 0.88**k * step, low, high)
        extremes.append(abs(best))
    return extremes[0], extremes[1]
