"""The verdict on a flown motion by the goals and limits of its problem.

A recording becomes one motion whose instants are the recording's rows, so that the formulas of goals and
limits apply to it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from ffsms_pin.checks import FloatArray, frozen
from ffsms_pin.geometry.distances import ClearanceStack, Least, least_of
from ffsms_pin.opt.derivatives import Variables
from ffsms_pin.opt.evaluation import violation_of
from ffsms_pin.opt.goals.path import Path
from ffsms_pin.opt.goals.pose_constraints import FrameGoal, end_errors, end_miss, end_misses, pose_errors
from ffsms_pin.opt.limits.clearance import Clearance
from ffsms_pin.opt.limits.limit import Limit, prepared
from ffsms_pin.opt.problem import Problem, given
from ffsms_pin.opt.rollouts import RecordedRollouts, Rollouts, apply_rates, forces
from ffsms_pin.robot import SpaceManipulator
from ffsms_pin.system.batch.stacks import apply, cross, rotations


class LeastClearance(NamedTuple):
    """The least distance of the two bodies that come nearest to violating their required clearance.

    Attributes
    ----------
    distance : float
        The distance [m]; negative if the bodies overlap.
    pair : str
        The names of the two bodies.
    time : float
        The time of the least distance [s].
    required : float
        The required clearance [m].
    place : tuple of three floats
        The nearest point on the first body, inertial axes [m].
    """

    distance: float
    pair: str
    time: float
    required: float
    place: tuple[float, float, float]

    @property
    def kept(self) -> bool:
        """True if the distance is at least the required clearance, up to a hundredth of a millimetre."""
        return self.distance >= self.required - 1e-5

    def __str__(self) -> str:
        where = ", ".join(f"{x:.3g}" for x in self.place)
        required = f"{1e3 * self.required:.3g} mm are required"
        return f"{self.pair}: {1e3 * self.distance:.1f} mm at {self.time:.4g} s near [{where}] m, {required}"


@dataclass(frozen=True, eq=False)
class Verdict:
    """The judgement of a flown motion by the goals and limits of its problem.

    Attributes
    ----------
    misses : tuple of str
        Messages about missed goals, an end before the deadline, overlaps, and violations of all limits other
        than clearances; empty if the motion has `arrived`.
    breaches : tuple of str
        The message about a violated clearance without an overlap. A motion with a breach may have `arrived`.
    path_error : ndarray, shape (K,)
        Distance from the path [m]; empty if the goal is not an `opt.Path`.
    orientation_error : ndarray, shape (K,)
        Angle from the end effector to the desired attitude [rad]; zero if any attitude is admissible.
    frame_errors : dict of str to ndarray, shape (K, 2)
        Distance [m] and angle [rad] from each `opt.FrameGoal`, by the name of the frame.
    clearance : LeastClearance or None
        The distance that is least compared with the required clearance; None if no clearance is required.
    """

    misses: tuple[str, ...] = ()
    breaches: tuple[str, ...] = ()
    orientation_error: FloatArray = field(default_factory=lambda: np.zeros(0))
    frame_errors: Mapping[str, FloatArray] = field(default_factory=dict)
    clearance: LeastClearance | None = None
    path_error: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def arrived(self) -> bool:
        """True if there are no `misses`."""
        return not self.misses


def recorded(
    problem: Problem,
    plant: SpaceManipulator,
    t: FloatArray,
    q: FloatArray,
    v: FloatArray,
    tau: FloatArray | None = None,
    wheel_momentum: FloatArray | None = None,
) -> RecordedRollouts:
    """Return a recording as one motion whose instants are the rows, with the goal of the problem.

    Parameters
    ----------
    problem : Problem
        The problem of the motion.
    plant : SpaceManipulator
        The flown robot.
    t, q, v : ndarray, shape (K,), (K, nq) and (K, 6 + n)
        Times from the start of the problem's motion [s]; Pinocchio's configurations and velocities.
    tau : ndarray, shape (K - 1, n), optional
        Joint torques in the steps between the rows [N m]. Default: the torques that the motion requires.
    wheel_momentum : ndarray, shape (K, w), optional
        Momenta of the wheels [N m s], used if wheels hold the attitude. Default: the momenta that the motion
        requires.
    """
    stack = plant.arm_stack(problem.mode)
    joints = np.array([plant.layout.positions(row) for row in q]).T
    rates, R, root = v[:, 6:].T, rotations(q[:, 3:7].T), q[:, :3].T
    arm = stack.evaluate(joints)
    linear, angular = v[:, :3].T, v[:, 3:6].T
    turning = arm.axes * stack.moves_tip[:, None]
    tip_velocity = linear + cross(angular, arm.tip) + apply_rates(arm.arm, rates)
    com = root + apply(R, arm.com)
    drift = angular - apply_rates(arm.spin, rates)
    variables = {
        "base_attitude": R,
        "angular_drift": drift,
        "end_effector": root + apply(R, arm.tip),
        "attitude": np.einsum("xyk,yzk->xzk", R, arm.tip_rotation),
        "velocity": apply(R, tip_velocity),
        "base_angular_velocity": apply(R, angular),
        "angular_velocity": apply(R, angular + apply_rates(turning, rates)),
        "base_position": root + apply(R, stack.base_com[:, None]),
    }
    steps = np.diff(t)
    weights = 0.5 * (np.append(steps, 0.0) + np.insert(steps, 0, 0.0))
    accelerations = np.gradient(rates, t, axis=1) if len(t) > 1 else np.zeros_like(rates)
    applied = forces(stack, joints, rates, accelerations, drift)
    if tau is not None and len(tau):
        applied[: plant.n] = np.vstack([tau, tau[-1:]]).T
    motion = RecordedRollouts(
        stack=stack,
        times=t,
        weights=weights,
        limit_weights=weights,
        last_tenth=np.flatnonzero(t >= 0.9 * t[-1] - 1e-9),
        joints=joints[:, None],
        rates=rates[:, None],
        accelerations=accelerations[:, None],
        forces=applied[:, None],
        evaluated=arm.stacked(),
        com=com,
        drift=(com[:, -1] - com[:, 0]) / max(float(t[-1] - t[0]), 1e-9),
        base_start=variables["base_position"][:, 0],
        rotation_start=R[..., 0],
        target=np.full((3, len(t)), np.nan),
        mean_speed=1.0,
        **{name: values[..., None, :] for name, values in variables.items()},
    )
    of_problem = given(problem, problem.goal, t)
    if problem.base_start is None:  # the base's limits are relative to the base's pose in the first row
        of_problem |= {"base_start": motion.base_start, "rotation_start": motion.rotation_start}
    if problem.wheels is not None and wheel_momentum is not None and wheel_momentum.size:
        of_problem |= {"wheels": plant.wheels, "measured_momenta": wheel_momentum.T[:, None]}
    return replace(motion, **of_problem)


def judge(
    problem: Problem,
    plant: SpaceManipulator,
    t: FloatArray,
    q: FloatArray,
    v: FloatArray,
    tau: FloatArray | None = None,
    wheel_momentum: FloatArray | None = None,
) -> Verdict:
    """Judge a flown motion by the goals and limits of its problem.

    The goal of the end effector is checked at the last row, within `Goal.reach` and `Goal.orientation_reach`.
    A goal with `Goal.exact` is checked at the deadline within its tolerance, velocities included. Required
    velocities of other goals are checked at the deadline. Their tolerances are `Goal.reach` in m/s and
    `Goal.orientation_reach` in rad/s. A motion that ends before the deadline is a miss. Every limit is
    checked by its `Limit.violation_in_flight`. The least clearance is checked at the rows and between them.
    An overlap is a miss, and a smaller violation is a breach.

    Parameters
    ----------
    problem : Problem
        The problem of the motion.
    plant : SpaceManipulator
        The flown robot.
    t, q, v : ndarray, shape (K,), (K, nq) and (K, 6 + n)
        The recording, see `recorded`.
    tau : ndarray, shape (K - 1, n), optional
        Joint torques in the steps between the rows [N m], see `recorded`.
    wheel_momentum : ndarray, shape (K, w), optional
        Momenta of the wheels [N m s], see `recorded`.
    """
    motion = recorded(problem, plant, t, q, v, tau, wheel_momentum)
    goal, misses, breaches = problem.goal, list[str](), list[str]()
    if t[-1] < problem.duration - 1e-6:
        misses.append(f"the flight ended at {t[-1]:.4g} s, before the deadline at {problem.duration:.4g} s")
    errors = pose_errors(goal, Variables(motion), "tip")
    if goal.exact:
        misses += _exact_misses(problem, motion, errors)
    else:
        misses += [*filter(None, [end_miss(goal, errors[-1], "the end effector")])]
        misses += _velocity_misses(problem, motion)
    misses += limit_misses(problem, problem.limits, motion)
    frames = {
        limit.frame: frozen(limit.pose_errors(motion))
        for limit in problem.limits
        if isinstance(limit, FrameGoal)
    }
    clearance = least_clearance(problem, plant, motion)
    if clearance is not None and not clearance.kept:
        (misses if clearance.distance < 0.0 else breaches).append(str(clearance))
    angle = frozen(errors[:, 1].copy())
    path = frozen(errors[:, 0].copy() if isinstance(goal, Path) else np.zeros(0))
    return Verdict(tuple(misses), tuple(breaches), angle, frames, clearance, path)


def limit_misses(problem: Problem, limits: Sequence[Limit], motion: RecordedRollouts) -> list[str]:
    """Return a message for each limit that a recorded motion of a problem violates."""
    robot: Any = motion.stack.robot
    misses = []
    for limit in limits:
        limit = limit if robot is problem.sms else prepared(limit, robot)
        violation = violation_of(limit, motion, "violation_in_flight")
        if violation.amount > 0.0:
            misses.append(violation.note)
    return misses


def least_clearance(problem: Problem, robot: SpaceManipulator, motion: Rollouts) -> LeastClearance | None:
    """Return the clearance of a motion that is least compared with its requirement, also between instants.

    The pairs are two bodies of the robot, or a body of the robot and an obstacle on the base, in space or on
    a client. The result is None if the problem has no clearance limit, or if no bodies can collide.
    """
    least = None
    for limit in problem.limits:
        if not isinstance(limit, Clearance):
            continue
        for stack in prepared(limit, robot).stacks:  # type: ignore[attr-defined]  # `prepared` returns a Clearance
            nearest = least_of(stack, motion, limit.clearance, math.inf)
            margin = float(stack.margins[nearest.pair]) if stack.obstacles else 0.0
            distance, required = float(nearest.value) + margin, limit.clearance + margin
            place = _nearest_point(stack, motion, nearest)
            here = LeastClearance(distance, stack.names[nearest.pair], nearest.time, required, place)
            if least is None or here.distance - here.required < least.distance - least.required:
                least = here
    return least


def _nearest_point(stack: ClearanceStack, motion: Rollouts, nearest: Least) -> tuple[float, float, float]:
    """Return the nearest point (3,) on the first body of a pair at the row nearest in time, inertial axes."""
    k = int(np.argmin(np.abs(motion.times - nearest.time)))
    poses, entry = stack.along(motion), (np.array([nearest.pair]), np.array([k]))
    _, placed = stack.slopes(poses, entry, stack.nearest(poses, entry))
    R, root = motion.base_attitude[..., 0, k], motion.base_position[:, 0, k]
    point = root + R @ (placed[0, :, 0] - motion.stack.base_com)
    return float(point[0]), float(point[1]), float(point[2])


def _contact(problem: Problem, motion: Rollouts, k: int) -> FloatArray:
    """Return the end effector's twist (6,) at row k relative to the goal's twist, inertial axes."""
    moving = [motion.velocity[:, 0, k], motion.angular_velocity[:, 0, k]]
    return np.asarray(np.concatenate(moving) - problem.place.twist)


def _exact_misses(problem: Problem, motion: Rollouts, errors: FloatArray) -> list[str]:
    """Return a message if an exact goal is missed at the deadline."""
    k = min(int(np.searchsorted(motion.times, problem.duration - 1e-9)), motion.last)
    distance, angle = errors[k].tolist()
    off = end_errors(problem.goal, distance, angle, _contact(problem, motion, k), problem.duration)
    text = end_misses(problem.goal, off)
    return [text] if text else []


def _velocity_misses(problem: Problem, motion: Rollouts) -> list[str]:
    """Return a message for each required velocity that is missed at the deadline."""
    goal, place = problem.goal, problem.place
    k = min(int(np.searchsorted(motion.times, problem.duration - 1e-9)), motion.last)
    linear, angular = np.linalg.norm(_contact(problem, motion, k).reshape(2, 3), axis=1)
    misses = []
    if place.velocity is not None and linear > goal.reach:
        misses.append(f"the end effector's velocity is {1e3 * linear:.3g} mm/s off at the deadline")
    if place.angular_velocity is not None and angular > goal.orientation_reach:
        off = f"{math.degrees(angular):.3g} deg/s off"
        misses.append(f"the end effector's angular velocity is {off} at the deadline")
    return misses
