"""The fastest time law along a path, against a linear program on a fine grid and against closed forms."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rolled import rolled_out_by_pinocchio
from scipy.optimize import linprog
from scipy.sparse import csr_array, vstack

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.search.path_following import _joint_path
from ffsms_pin.opt.search.time_law import LimitRows, fastest_law, limit_rows


@pytest.fixture(scope="module")
def q0(planar: Any) -> Any:
    return planar.configuration([0.3, 0.6, 0.5])


def circle(pose: Any) -> Any:
    """Return a circle of 50 mm through a pose, by a parameter from 0 to 1."""
    return lambda x: (
        pose.translation + 0.05 * np.array([np.cos(2.0 * np.pi * x) - 1.0, np.sin(2.0 * np.pi * x), 0.0])
    )


def wave(pose: Any) -> Any:
    """Return a wavy line from a pose on, by a parameter from 0 to 1."""
    return lambda x: pose.translation + np.array([-0.2 * x, 0.02 * np.sin(4.0 * np.pi * x), 0.0])


def least_time(rows: LimitRows) -> float:
    """Return the least time by a linear program that maximizes the squares of ds/dt."""
    count, steps = len(rows.shares), np.diff(rows.shares)
    i = np.arange(count - 1)
    shape = (count - 1, count)
    blocks = []
    for j in range(rows.a.shape[1]):
        for end in (i, i + 1):  # both ends of each interval, over which d^2 s/dt^2 is constant
            u = csr_array(
                (
                    np.tile(rows.a[end, j] / (2.0 * steps), 2) * np.repeat([-1.0, 1.0], count - 1),
                    (np.tile(i, 2), np.concatenate([i, i + 1])),
                ),
                shape=shape,
            )
            blocks.append(u + csr_array((rows.b[end, j], (i, end)), shape=shape))
    largest = np.repeat(rows.c, 2 * (count - 1))
    upper = rows.largest.copy()
    upper[[0, -1]] = 0.0
    result = linprog(-np.ones(count), vstack(blocks), largest, bounds=np.stack([0.0 * upper, upper], axis=1))
    assert result.success
    speeds = np.sqrt(np.maximum(result.x, 0.0))
    return float(np.sum(2.0 * steps / (speeds[1:] + speeds[:-1])))


def test_the_time_law_of_one_joint_agrees_with_closed_forms() -> None:
    """The time is 2 sqrt(length / acceleration), or a trapezoidal profile with a rate limit."""
    shares = np.linspace(0.0, 1.0, 401)
    a = np.tile([1.0, -1.0], (401, 1))
    rows = LimitRows(shares, a, 0.0 * a, np.array([0.5, 0.5]), np.full(401, 1e6))
    law = fastest_law(rows)
    assert law is not None
    assert law.times[-1] == pytest.approx(2.0 * np.sqrt(1.0 / 0.5), rel=1e-3)
    law = fastest_law(rows._replace(largest=np.full(401, 0.2**2)))
    assert law is not None
    assert law.times[-1] == pytest.approx(1.0 / 0.2 + 0.2 / 0.5, rel=1e-3)
    assert law(np.array([-1.0, 0.5 * law.times[-1], 99.0])) == pytest.approx([0.0, 0.5, 1.0])


@pytest.mark.parametrize("curve", [circle, wave])
def test_the_time_law_is_near_the_optimum_of_a_fine_grid(planar: Any, q0: Any, curve: Any) -> None:
    """The duration is within 5 % of a linear program on 2000 intervals, and all limits are kept."""
    path = opt.Path(curve(planar.at(q0).end_effector_pose), parameter=(0.0, 1.0), timing="fastest")
    problem = opt.Problem(planar, q0, path, duration=30.0)
    plan = opt.solve(problem)
    assert plan.reached, plan.note
    assert plan.shortest_duration == plan.duration < 30.0
    joint_path = _joint_path(problem, problem.goal)
    assert joint_path is not None
    fine = np.linspace(0.0, 1.0, 2001)
    finer = {
        name: np.stack([np.interp(fine, joint_path.times, row) for row in getattr(joint_path, name)[:, 0]])[
            :, None
        ]
        for name in ("joints", "rates")
    }
    motion: Any = SimpleNamespace(stack=joint_path.stack, times=fine, **finer)
    bounds = [opt.JointLimits().speed_bound(motion), opt.TorqueLimits().speed_bound(motion)]
    best = least_time(limit_rows(fine, bounds, margin=0.0))
    assert 0.995 * best < plan.duration < 1.05 * best
    used = np.abs(plan.joint_accelerations) / planar.limits.acceleration
    assert (
        np.median(
            np.maximum(used.max(axis=1), (np.abs(plan.joint_rates[1:]) / planar.limits.velocity).max(axis=1))
        )
        > 0.95
    )
    _, poses = rolled_out_by_pinocchio(planar, plan)
    samples = np.array([curve(planar.at(q0).end_effector_pose)(x) for x in np.linspace(0.0, 1.0, 4001)])
    distances = [np.linalg.norm(samples - pose.translation, axis=1).min() for pose in poses[::7]]
    assert max(distances) < 2e-4


def test_torque_limits_lengthen_the_duration(planar: Any, q0: Any) -> None:
    """Weak joints take longer, and no torque exceeds its limit."""
    path = opt.Path(circle(planar.at(q0).end_effector_pose), parameter=(0.0, 1.0), timing="fastest")
    quick = opt.plan(planar, q0, path, duration=30.0)
    weak = planar.with_limits(replace(planar.limits, torque=0.3 * np.abs(quick.tau).max(axis=0)))
    plan = opt.plan(weak, q0, path, duration=30.0)
    assert plan.reached, plan.note
    assert plan.duration > 1.3 * quick.duration
    assert 0.9 < plan.torque_share.max() <= 1.0


def test_limits_that_are_left_out_do_not_apply(planar: Any, q0: Any) -> None:
    """Plan with joint limits alone and with torque limits alone; without both there is no least time."""
    path = opt.Path(circle(planar.at(q0).end_effector_pose), parameter=(0.0, 1.0), timing="fastest")
    quick = opt.plan(planar, q0, path, duration=30.0)
    weak = planar.with_limits(replace(planar.limits, torque=0.3 * np.abs(quick.tau).max(axis=0)))
    joints, torques = opt.JointLimits(), opt.TorqueLimits()
    by_rates = opt.solve(opt.Problem(weak, q0, path, duration=30.0, limits=[joints]))
    assert by_rates.reached, by_rates.note
    assert by_rates.duration == pytest.approx(quick.duration, rel=1e-2)
    assert by_rates.torque_share.max() > 2.0
    by_torques = opt.solve(opt.Problem(planar, q0, path, duration=30.0, dt=0.002, limits=[torques]))
    assert by_torques.reached, by_torques.note
    assert by_torques.duration < 0.8 * quick.duration
    assert 0.9 < by_torques.torque_share.max() <= 1.0
    assert (np.abs(by_torques.joint_accelerations) / planar.limits.acceleration).max() > 1.2
    with pytest.raises(InvalidValue, match=r"limits must include opt.JointLimits or opt.TorqueLimits if"):
        opt.solve(opt.Problem(planar, q0, path, duration=30.0, limits=[opt.Clearance()]))


def test_the_fastest_path_begins_after_the_approach(planar: Any, q0: Any) -> None:
    """The approach ends at rest at the start of the path."""
    pose = planar.at(q0).end_effector_pose

    def curve(x: float) -> Any:
        return circle(pose)(x) + np.array([-0.05, 0.0, 0.0])

    path = opt.Path(curve, parameter=(0.0, 1.0), timing="fastest", approach_time=3.0)
    plan = opt.plan(planar, q0, path, duration=30.0)
    assert plan.reached, plan.note
    assert 4.0 < plan.duration < 12.0
    assert np.linalg.norm(plan.end_effector[round(3.0 / plan.dt)] - curve(0.0)) < 1e-4


def test_the_note_gives_the_duration_of_the_fastest_path(planar: Any, q0: Any) -> None:
    """A plan in the reported duration is reached."""
    path = opt.Path(circle(planar.at(q0).end_effector_pose), parameter=(0.0, 1.0), timing="fastest")
    plan = opt.plan(planar, q0, path, duration=2.0)
    assert not plan.reached
    assert (
        f"with the fastest time law that was found for the path, {plan.shortest_duration:.2f} s" in plan.note
    )
    assert opt.plan(planar, q0, path, duration=plan.shortest_duration).reached
    assert plan.problem is not None
    assert not opt.Replanning(plan.problem, plan=plan).sample(0.0)[1].any()  # re-planned at constant speed


def test_shortest_refuses_paths(planar: Any, q0: Any) -> None:
    """The error names the timing of the path as remedy."""
    path = opt.Path(circle(planar.at(q0).end_effector_pose), parameter=(0.0, 1.0))
    with pytest.raises(InvalidValue, match='timing="fastest"'):
        opt.shortest(opt.Problem(planar, q0, path, duration=10.0))


def test_paths_that_depend_on_time_or_momentum_refuse_the_fastest_timing(planar: Any, q0: Any) -> None:
    """The message names the remedy."""
    curve = circle(planar.at(q0).end_effector_pose)
    with pytest.raises(InvalidValue, match='timing can be "fastest" only for a geometric curve'):
        opt.Path(curve, timing="fastest")
    client = ffsms.Client(80.0, [6.0, 9.0, 11.0])
    with pytest.raises(InvalidValue, match='timing can be "fastest" only in inertial axes or on the base'):
        opt.Path(curve, parameter=(0.0, 1.0), timing="fastest", frame=client)
    path = opt.Path(curve, parameter=(0.0, 1.0), timing="fastest")
    with pytest.raises(
        InvalidValue, match='timing can be "fastest" only if the robot starts at rest, without momentum'
    ):
        opt.plan(planar, q0, path, duration=30.0, momentum=[0.1, 0.0, 0.0, 0.0, 0.0, 0.0])


def test_locked_joints_stay_on_the_fastest_path(panda: Any, bent: Any) -> None:
    """A locked joint stays at all points of the path, including the first."""
    tool = panda.at(bent).end_effector_pose
    line = [tool.translation, tool.act(np.array([0.15, 0.05, 0.0]))]
    path = opt.Path(line, timing="fastest")
    problem = opt.Problem(panda, bent, path, duration=20.0, locked=["panda_joint3"])
    joint_path = _joint_path(problem, problem.goal)
    assert joint_path is not None
    assert np.abs(joint_path.rates[2]).max() < 1e-9
    assert np.ptp(joint_path.joints[2]) < 1e-9
    assert np.abs(np.diff(joint_path.rates, axis=-1)).max() < 0.02  # no jump


def test_step_methods_refuse_the_fastest_timing(planar: Any, q0: Any) -> None:
    """Step methods would follow the path at a constant speed."""
    path = opt.Path(circle(planar.at(q0).end_effector_pose), parameter=(0.0, 1.0), timing="fastest")
    with pytest.raises(InvalidValue, match='does not support timing="fastest"'):
        opt.plan(planar, q0, path, duration=30.0, method="resolved-rate")


def test_a_limit_on_the_base_rate_lengthens_the_duration(planar: Any, q0: Any) -> None:
    """The largest base rate is close to its limit and not above it."""
    path = opt.Path(circle(planar.at(q0).end_effector_pose), parameter=(0.0, 1.0), timing="fastest")
    free = opt.plan(planar, q0, path, duration=30.0)
    largest = 0.5 * float(np.abs(free.v[:, 3:6]).max())
    plan = opt.plan(planar, q0, path, duration=30.0, base_limits=opt.BaseLimits(attitude_rate=largest))
    assert plan.reached, plan.note
    speed = np.linalg.norm(plan.v[:, 3:6], axis=1)
    assert 0.97 * largest < speed.max() <= largest
    assert plan.duration > 1.1 * free.duration


def test_wheel_momentum_and_wheel_torque_lengthen_the_duration(panda: Any, bent: Any) -> None:
    """Each limit slows the motion by itself; an initial wheel momentum slows it further."""
    tool = panda.at(bent).end_effector_pose
    line = opt.Path([tool.translation, tool.act(np.array([0.15, 0.05, 0.0]))], timing="fastest")

    def fastest(momentum: float, torque: float, start: Any = None) -> opt.Trajectory:
        wheels = ffsms.ReactionWheels(np.eye(3), 0.01, torque=torque, momentum=momentum)
        robot = panda.with_actuators(wheels=wheels)
        problem = opt.Problem(robot, bent, line, 40.0, 0.02, mode="rotation-floating", wheel_momentum=start)
        plan = opt.solve(problem)
        assert plan.reached, plan.note
        return plan

    free = fastest(1e3, 1e3)
    used = np.abs(free.wheel_momentum).max()
    slow = fastest(0.5 * used, 1e3)
    assert slow.duration > 1.2 * free.duration
    assert 0.45 * used < np.abs(slow.wheel_momentum).max() <= 0.5 * used
    torque = np.abs(np.diff(free.wheel_momentum, axis=0)).max() / free.dt
    weak = fastest(1e3, 0.5 * torque)
    assert weak.duration > 1.1 * free.duration
    assert np.abs(np.diff(weak.wheel_momentum, axis=0)).max() / weak.dt <= 0.5 * torque * (1.0 + 1e-6)
    k, i = np.unravel_index(np.argmax(np.abs(free.wheel_momentum)), free.wheel_momentum.shape)
    start = np.zeros(3)
    start[i] = 0.25 * used * np.sign(free.wheel_momentum[k, i])
    assert fastest(0.5 * used, 1e3, start).duration > 1.1 * slow.duration


def test_the_fastest_path_keeps_the_box_of_alpha(panda: Any, bent: Any) -> None:
    """No principal direction of the coupling moves faster than the paper's box allows."""
    quick = panda.with_limits(replace(panda.limits, velocity=0.0 * panda.limits.velocity + 10.0))
    tool = quick.at(bent).end_effector_pose
    line = opt.Path([tool.translation, tool.act(np.array([0.15, 0.3, 0.0]))], timing="fastest")
    limits = [opt.JointLimits(), opt.AlphaBox()]
    plans = [opt.solve(opt.Problem(quick, bent, line, 40.0, 0.005, limits=limits[:k])) for k in (1, 2)]
    assert all(plan.reached for plan in plans), plans[1].note
    assert plans[0].largest_alpha > 1.0 >= plans[1].largest_alpha
