"""Where the search starts: straight joint-space moves that end at the target, and greedy marches.

A joint goal whose straight move ends at the target, the base reacting, gives a start that arrives; goals from
all over give the ways round. A goal with an approach is entered from one side: moves pass the approach. A
greedy march of the paper's step is free of cost wherever nothing stops it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.goals import Place
from ffsms_pin.opt.horizon.control_qp import at_rest, braking
from ffsms_pin.opt.horizon.shooting import DAMPING, GoalFromStart, joint_range, least_squares
from ffsms_pin.opt.horizon.spline import RateSpline
from ffsms_pin.opt.motion.frame import RobotFrame
from ffsms_pin.opt.motion.motions import apply_rates
from ffsms_pin.opt.problem import Problem
from ffsms_pin.opt.step.march import Progress, Steps, march, sides_across, start_sides
from ffsms_pin.opt.step.programme import StepWeights
from ffsms_pin.opt.step.stepper import Stepper
from ffsms_pin.opt.trajectory import Trajectory, measure
from ffsms_pin.system.base_motion import advance
from ffsms_pin.system.batch.stacks import exp3

__all__ = [
    "REFERENCE_WEIGHTS",
    "cone_marches",
    "free_marches",
    "landed",
    "march_starts",
    "marched",
    "missed_at",
    "moves_to",
    "reference_stepper",
    "straight_moves",
]

# Of the references, and of re-planned motions: ten times the step's own price of redundant motion, and still
# too little to keep an arm from leaving a singular start.
REFERENCE_WEIGHTS = StepWeights(effort=1e-5)


def straight_moves(problem: Problem, spline: RateSpline, goals: FloatArray) -> FloatArray:
    """Control points (K, M, n) of straight joint-space moves of least acceleration.

    A joint that the time is too short for goes as far as its rate and acceleration limits let it.
    """
    end = spline.position_points.free[-1]
    system = np.block([[spline.squared_acceleration, end[:, None]], [end[None], np.zeros((1, 1))]])
    profile = np.linalg.solve(system, np.append(np.zeros(spline.size), 1.0))[:-1]
    limits = problem.sms.limits
    # An arm that moves at the start first brakes, and goes the rest of the way.
    brake = braking(problem, spline)
    stopped = spline.position_points.of(brake, problem.joint_rates)[-1]
    way = goals - problem.joints0 - stopped
    hardest = np.max(np.abs(spline.acceleration_points.free @ profile))
    rate = np.max(np.abs(profile)) * np.abs(way) / limits.velocity
    acceleration = hardest * np.abs(way) / limits.acceleration
    way = way / np.maximum(1.0, 1.001 * np.maximum(rate, acceleration))
    return np.asarray(brake + profile[:, None] * way[:, None, :])


def moves_to(problem: Problem, spline: RateSpline, goals: FloatArray) -> FloatArray:
    """Control points (K, M, n) of moves to joint goals (K, n): straight, or by way of the goal's approach."""
    approach = problem.goal.approach(problem.duration)
    if not approach or not len(goals):
        return straight_moves(problem, spline, goals)
    from scipy.interpolate import CubicHermiteSpline  # slow to load

    end, arm = problem.goal.place(problem.duration), problem.stack.evaluate(goals.T)
    velocity, spin = (np.zeros(3) if one is None else one for one in (end.velocity, end.spin))
    # The base as it is turned where the tip is at the goal.
    joints, base = goals, end.base_attitude(arm.tip_rotation)
    J = missed_at(problem, end, problem.duration, joints, base)[1]
    damping = DAMPING * problem.stack.length**2
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
    wanted = CubicHermiteSpline(times, places, rates)(instants, 1)
    return spline.nearest(instants, np.swapaxes(wanted, 0, 1), problem.joint_rates)


def missed_at(
    problem: Problem, place: Place, t: float, joints: FloatArray, base: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """What postures (K, n) on bases (3, 3, K) miss of a place at t [s] (K, 6), and slopes (K, 6, n)."""
    centre = problem.com0 + t * problem.drift
    wanted = GoalFromStart(place.transformed(-centre, np.eye(3)), RobotFrame.of(problem.stack))
    error, columns = wanted.missed(problem.stack.evaluate(joints.T), base)
    return error.T, columns.transpose(2, 0, 1) * problem.free


def _back(
    problem: Problem, joints: FloatArray, base: FloatArray, t: float, place: Place
) -> tuple[FloatArray, FloatArray]:
    """From postures to those with the end effector at a place: Newton's method, the base reacting."""
    low, high = problem.sms.limits.lower, problem.sms.limits.upper
    damping, stuck = DAMPING * problem.stack.length**2, np.zeros(joints.shape, dtype=bool)
    for _ in range(6):
        missed, J = missed_at(problem, place, t, joints, base)
        # A radian counts little: an arm that is stretched out at the goal may have to turn to go back.
        weights = np.repeat([1.0, 0.1 * problem.stack.length], [3, missed.shape[1] - 3])
        step = least_squares(weights[:, None] * J * ~stuck[:, None], weights * missed, damping)
        step *= np.minimum(1.0, 0.2 / np.maximum(np.abs(step).max(axis=1), 1e-9))[:, None]
        wanted = joints + step
        stuck = (wanted < low) | (wanted > high)
        step = np.clip(wanted, low, high) - joints
        spin = problem.stack.evaluate(joints.T).spin
        base = np.einsum("xyk,yzk->xzk", base, exp3(apply_rates(spin, step.T)))
        joints = joints + step
    return joints, base


def march_starts(problem: Problem, spline: RateSpline, steps: int) -> FloatArray:
    """Control points (S, M, n) nearest to the marches of so many steps."""
    middles = (np.arange(steps) + 0.5) * problem.duration / steps
    return spline.nearest(middles, cone_marches(problem, steps), problem.joint_rates)


def cone_marches(problem: Problem, steps: int) -> FloatArray:
    """Joint rates (S, steps, n) in the middles of steps: a march for each side of the cone, one straight.

    A place that rides on the base, or is free about an axis, counts as seen from the start.
    """
    place = problem.goal.place(problem.duration).aim(problem.sms, problem.q0)
    low, high = joint_range(problem)
    most = np.where(problem.free, 0.8 * np.minimum(problem.sms.limits.velocity, 1e6), 0.0)
    J = problem.rotation0 @ problem.arm0.jstar[..., 0]
    sides = np.array([*sides_across(place.position - problem.tip0, J), np.zeros(3)])
    numbers = [problem.duration, problem.kappa, problem.mean_speed, 0.003 * problem.stack.length]
    start = [place.position, problem.com0, problem.drift, problem.rotation0.ravel()]
    joints = np.stack([problem.joints0, low, high, most])
    shared = np.concatenate([numbers, *start])
    return kernel.cone_marches(problem.stack.tree, steps, shared, place.rotation, joints, sides)


def free_marches(problem: Problem, budget: float) -> Iterator[FloatArray]:
    """Joint rates (N + 1, n) of marches that cost less than a budget [s], one for each side, landed.

    Given up where one has cost more, a step's programme was not solved, or it will not arrive in time.
    """
    place, sms, dt, steps = problem.goal.place(problem.duration), problem.sms, problem.dt, problem.steps
    stepper, mode = Stepper.of(problem), problem.mode
    for side in start_sides(sms, problem.q0, place.position, mode):
        stepper.reset(side)
        q, cost, k, nodes, rates = problem.q0, 0.0, 0, [0], [problem.joint_rates]
        while k < steps:
            stride = max(1, (steps - k) // 60)  # far from the deadline nothing changes fast
            stepper.dt = stride * dt
            # The paper pairs rates with where the arm was one step before.
            before, _ = advance(sms, q, rates[-1], np.zeros(sms.n), stepper.dt - dt, problem.momentum, mode)
            step = stepper.advance(before, rates[-1], place.position, (steps - k) * dt, place.rotation)
            cost += step.cost * stepper.dt
            way = place.position - sms.at(q).end_effector_pose.translation
            behind = float(np.linalg.norm(way)) > 1.5 * problem.mean_speed * (steps - k) * dt
            if cost > budget or not step.solved or behind:
                break
            slope = (step.joint_rates - rates[-1]) / stepper.dt
            q, _ = advance(sms, q, rates[-1], slope, stepper.dt, problem.momentum, mode)
            k += stride
            nodes.append(k)
            rates.append(step.joint_rates)
        else:
            at = np.arange(steps + 1)
            yield landed(problem, np.stack([np.interp(at, nodes, one) for one in np.array(rates).T], axis=1))


def reference_stepper(problem: Problem, method: str) -> Stepper:
    """The stepper of one of the classical references."""
    return Stepper.of(problem, method, REFERENCE_WEIGHTS, limits=problem.step_limits, terms=())


def marched(problem: Problem, stepper: Steps, progress: Progress | None = None) -> Trajectory:
    """The finished motion of single steps to the problem's goal."""
    place = problem.goal.place(problem.duration)
    q0, rates0, duration = problem.q0, problem.joint_rates, problem.duration
    rates, note = march(stepper, q0, rates0, place.position, duration, place.rotation, progress)
    return measure(problem, rates, note)


def landed(problem: Problem, rates: FloatArray) -> FloatArray:
    """The same motion (N + 1, n), at rest at the end: slowed down where a joint would brake too late.

    A joint brakes with half of what it can; all slow down by one share, so that the cost stays.
    """
    left = np.arange(len(rates))[::-1, None]
    most = at_rest(problem) + 0.5 * problem.dt * left * np.minimum(problem.sms.limits.acceleration, 1e6)
    share = np.min(most / np.maximum(np.abs(rates), 1e-12), axis=1, keepdims=True)
    share[0] = 1.0  # the rates at the start are given
    return np.asarray(rates * np.minimum(share, 1.0))
