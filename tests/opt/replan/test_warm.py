"""Warm-started re-planning of the rest of a motion."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.opt.goals.goal import Changed
from ffsms_pin.opt.replan.options import ReplanOptions
from ffsms_pin.opt.replan.rest import JointPlan, replanned, rest_of
from ffsms_pin.opt.trajectory import measure
from ffsms_pin.simulation import perturb

Array = NDArray[np.float64]
DURATION, DT = 8.0, 0.02
OPTIONS = ReplanOptions()


@pytest.fixture(scope="module")
def problem(panda: ffsms.SpaceManipulator) -> opt.Problem:
    middle = 0.5 * (panda.limits.lower + panda.limits.upper)
    base = pin.SE3(pin.rpy.rpyToMatrix(0.4, -0.7, 1.1), np.array([0.5, -0.2, 0.3]))
    q0 = panda.configuration(middle, base)
    displacement = base.rotation @ np.array([-0.15, 0.2, -0.2])
    target = panda.at(q0).end_effector_pose.translation + displacement
    return opt.Problem(panda, q0, target, DURATION, DT)


@pytest.fixture(scope="module")
def plan(problem: opt.Problem) -> opt.Trajectory:
    plan = opt.solve(problem)
    assert plan.reached
    return plan


def replan_rest(
    problem: opt.Problem, plan: opt.Trajectory, t: float, **changes: Any
) -> tuple[opt.Problem, JointPlan]:
    """Return the remaining problem from a node of its plan and its re-plan; `changes` replaces the state."""
    k = round(t / problem.dt)
    values = {
        "sms": problem.sms,
        "q": plan.q[k],
        "joints": plan.joint_positions[k],
        "rates": plan.joint_rates[k],
        "base_start": plan.q[0, :7],
        "locked": (),
        **changes,
    }
    rest = rest_of(problem, t=t, **values)
    last = JointPlan.of_trajectory(plan)
    return rest, replanned(rest, t, values["joints"], last, OPTIONS)


@pytest.mark.parametrize("t", [0.8, 3.2, 6.4, 7.6])
def test_replanning_an_undisturbed_motion_keeps_it(
    t: float, problem: opt.Problem, plan: opt.Trajectory
) -> None:
    k = round(t / DT)
    rest, replanned_motion = replan_rest(problem, plan, t)
    assert np.abs(replanned_motion.positions - plan.joint_positions[k:]).max() < 0.03
    assert np.ptp(plan.joint_positions[k:], axis=0).max() > {0.8: 0.3, 3.2: 0.1}.get(t, 0.0)
    finished = measure(rest, replanned_motion.rates)
    assert finished.clear
    assert finished.position_error[-1] < 1e-3
    assert replanned_motion.miss == pytest.approx(finished.position_error[-1], abs=2e-4)
    assert replanned_motion.start == t


def test_replanned_commands_are_continuous(problem: opt.Problem, plan: opt.Trajectory) -> None:
    _, replanned_motion = replan_rest(problem, plan, 2.0)
    np.testing.assert_array_equal(replanned_motion.rates[0], plan.joint_rates[100])
    np.testing.assert_array_equal(replanned_motion.positions[0], plan.joint_positions[100])
    assert (
        np.abs(np.diff(replanned_motion.rates, axis=0)) <= DT * problem.sms.limits.acceleration + 1e-9
    ).all()


def test_replanning_corrects_an_error_of_the_base_pose(problem: opt.Problem, plan: opt.Trajectory) -> None:
    k, q = 150, plan.q[150].copy()
    base = pin.XYZQUATToSE3(q[:7]) * pin.exp6(np.array([0.01, -0.02, 0.01, 0.02, 0.01, -0.03]))
    q[:7] = pin.SE3ToXYZQUAT(base)
    rest, replanned_motion = replan_rest(problem, plan, k * DT, q=q)
    assert measure(rest, plan.joint_rates[k:]).position_error[-1] > 0.02
    assert measure(rest, replanned_motion.rates).position_error[-1] < 1.2e-3


def test_replanning_corrects_an_error_of_mass(problem: opt.Problem, plan: opt.Trajectory) -> None:
    other = perturb(problem.sms, arm_mass=1.3)
    rest, replanned_motion = replan_rest(problem, plan, 1.0, sms=other)
    assert measure(rest, plan.joint_rates[50:]).position_error[-1] > 5e-3
    assert measure(rest, replanned_motion.rates).position_error[-1] < 1.2e-3


def test_replanning_keeps_locked_joints_exactly(problem: opt.Problem, plan: opt.Trajectory) -> None:
    j = 0
    name, rates = problem.sms.joint_names[j], plan.joint_rates[100].copy()
    assert abs(rates[j]) > 1e-3
    rates[j] = 0.0
    rest, replanned_motion = replan_rest(problem, plan, 2.0, rates=rates, locked=[name])
    np.testing.assert_array_equal(replanned_motion.rates[:, j], 0.0)
    np.testing.assert_array_equal(replanned_motion.positions[:, j], plan.joint_positions[100, j])
    assert np.abs(replanned_motion.rates[:, 2]).max() > 1e-3
    # Locking a joint moves the end by about 0.1 m, which takes several re-plans to correct.
    assert measure(rest, np.where(rest.free, plan.joint_rates[100:], 0.0)).position_error[-1] > 0.08
    for _ in range(3):
        replanned_motion = replanned(rest, 2.0, plan.joint_positions[100], replanned_motion, OPTIONS)
        np.testing.assert_array_equal(replanned_motion.rates[:, j], 0.0)
    assert replanned_motion.miss < 2e-3


def test_replanning_from_other_rates_keeps_limits(problem: opt.Problem, plan: opt.Trajectory) -> None:
    """Some joints start at their rate limits, others move backwards."""
    limits = problem.sms.limits
    rates = 0.5 * limits.velocity * np.array([1, -1, 0.4, -0.3, 1, -1, 1])
    rates[0] = limits.velocity[0]
    rest, replanned_motion = replan_rest(problem, plan, 1.0, rates=rates)
    finished = measure(rest, replanned_motion.rates)
    assert "joints" not in finished.broken
    assert (np.abs(np.diff(replanned_motion.rates, axis=0)) <= DT * limits.acceleration + 1e-9).all()
    assert limits.violation(replanned_motion.positions).max() == 0.0
    np.testing.assert_array_equal(replanned_motion.rates[0], rates)
    np.testing.assert_allclose(replanned_motion.rates[-1], 0.0, atol=1e-3)


def test_base_limits_count_from_the_start_of_the_whole_motion(
    problem: opt.Problem, plan: opt.Trajectory
) -> None:
    start = pin.XYZQUATToSE3(plan.q[0, :7]).rotation
    turns = [np.linalg.norm(pin.log3(start.T @ pin.XYZQUATToSE3(q[:7]).rotation)) for q in plan.q]
    limit, k = 0.9 * float(max(turns)), 120
    limited = replace(problem, limits=[*problem.limits, opt.BaseLimits(attitude=limit)])
    # The violation is measured from the start of the whole motion.
    rest, _ = replan_rest(limited, plan, k * DT)
    assert measure(rest, plan.joint_rates[k:]).broken["base"] == pytest.approx(max(turns) - limit, rel=0.05)
    limited_plan = opt.solve(limited)
    assert limited_plan.reached
    rest, replanned_motion = replan_rest(limited, limited_plan, k * DT)
    finished = measure(rest, replanned_motion.rates)
    assert finished.broken == {}
    rotations = [np.linalg.norm(pin.log3(start.T @ pin.XYZQUATToSE3(q[:7]).rotation)) for q in finished.q]
    assert 0.8 * limit < max(rotations) <= limit
    assert finished.position_error[-1] < 2e-3


def test_a_moving_goal_is_shifted_in_time(planar: ffsms.SpaceManipulator) -> None:
    times: list[float] = []

    def path(t: float) -> Array:
        times.append(t)
        return np.array([0.7 + 0.01 * t, 0.3, 0.0])

    goal = Changed(opt.Moving(path), time_offset=2.0)
    np.testing.assert_allclose(goal.place(1.0).position, [0.73, 0.3, 0.0])
    velocity = goal.place(1.0).velocity
    assert velocity is not None
    np.testing.assert_allclose(velocity, [0.01, 0.0, 0.0], atol=1e-9)
    times.clear()
    goal.places(np.array([0.0, 1.0]))
    assert times == [2.0, 3.0]
    q0 = planar.configuration([0.5, 0.5, 0.5])
    whole = opt.Problem(planar, q0, opt.Moving(path), 6.0, 0.02)
    rest = rest_of(whole, planar, 2.0, q0, planar.layout.positions(q0), np.zeros(3), q0[:7])
    assert rest.duration == pytest.approx(4.0)
    np.testing.assert_allclose(rest.goal.place(4.0).position, whole.goal.place(6.0).position)


def test_a_custom_base_limit_counts_from_the_start(planar: ffsms.SpaceManipulator) -> None:
    q0 = planar.configuration([0.5, 0.5, 0.5])
    whole = opt.Problem(
        planar, q0, [0.8, 0.3, 0.0], 6.0, 0.02, limits=[opt.JointLimits(), opt.BaseLimits(translation=0.05)]
    )
    other_base = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    rest = rest_of(whole, planar, 2.0, q0, planar.layout.positions(q0), np.zeros(3), other_base)
    joints, base = rest.limits
    assert isinstance(joints, opt.JointLimits)
    assert isinstance(base, opt.BaseLimits)
    assert (base.name, base.margin) == ("base", opt.BaseLimits().margin)
    still = measure(rest, np.zeros((rest.steps + 1, 3)))
    shift = np.linalg.norm(pin.XYZQUATToSE3(q0[:7]).act(planar.base_com) - other_base[:3] - planar.base_com)
    assert still.broken["base"] == pytest.approx(shift - 0.05)


def test_a_joint_plan_interpolates_rates_linearly() -> None:
    rng = np.random.default_rng(2)
    rates = rng.normal(size=(6, 2))
    plan = JointPlan(1.0, 0.1, np.array([0.3, -0.2]), rates, 0.0)
    np.testing.assert_allclose(plan.sample(1.25)[1], 0.5 * (rates[2] + rates[3]))
    fine = 1.0 + np.linspace(0.0, 0.5, 5001)
    samples = plan.rates_at(fine)
    travel = 0.5 * np.diff(fine)[:, None] * (samples[1:] + samples[:-1])
    np.testing.assert_allclose(plan.sample(1.5)[0], np.array([0.3, -0.2]) + travel.sum(axis=0), atol=1e-9)
    np.testing.assert_array_equal(plan.sample(2.0)[1], 0.0)
    np.testing.assert_allclose(plan.sample(2.0)[0], plan.positions[-1])
    np.testing.assert_array_equal(plan.rates_at(np.array([1.6])), 0.0)
