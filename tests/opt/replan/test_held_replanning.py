"""Re-planning in the closed loop with a controlled base attitude."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.control import Coordinated
from ffsms_pin.opt.replan.learning import ScaleFactors
from ffsms_pin.opt.replan.rest import rest_of
from ffsms_pin.opt.trajectory import measure
from ffsms_pin.robot.base_motion import advance
from ffsms_pin.simulation import Tracking, perturb

PYRAMID = [[1, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]]
TARGET, DURATION, DT = [0.45, 0.75, 0.0], 8.0, 0.04


@pytest.fixture(scope="module")
def robot() -> ffsms.SpaceManipulator:
    """`planar_3r` with four wheels of 0.1 N m and 1 N m s."""
    wheels = ffsms.ReactionWheels(PYRAMID, 0.001364, 0.1, 1.0)
    return ffsms.load("planar_3r").with_actuators(wheels=wheels)


@pytest.fixture(scope="module")
def problem(robot: ffsms.SpaceManipulator) -> opt.Problem:
    q0 = robot.configuration(np.radians([1.0, 1.0, 1.0]))
    return opt.Problem(robot, q0, TARGET, DURATION, DT, mode="rotation-floating")


@pytest.fixture(scope="module")
def plan(problem: opt.Problem) -> opt.Trajectory:
    return opt.solve(problem)


def simulate_reference(problem: opt.Problem, reference: Any, plant: ffsms.SpaceManipulator) -> Tracking:
    law = Coordinated(problem.sms, 100.0, 20.0, bandwidth=2.5)
    return ffsms.simulate(problem.sms, reference, law, 1e-2, q0=problem.q0, plant=plant, base_controller=law)


def largest_rotation(run: Tracking) -> float:
    """Return the largest angle from the initial attitude [deg]."""
    first = pin.Quaternion(run.q[0, 3:7])
    return float(np.degrees(max(first.angularDistance(pin.Quaternion(row)) for row in run.q[::10, 3:7])))


@pytest.mark.slow
@pytest.mark.parametrize(("arm", "base"), [(1.2, 0.9), (0.8, 1.1)])
def test_replanning_arrives_with_a_wrong_model(
    problem: opt.Problem, plan: opt.Trajectory, arm: float, base: float
) -> None:
    """A plan without re-planning misses by more than 5 mm."""
    plant = perturb(problem.sms, arm_mass=arm, base_mass=base)
    reference = opt.Replanning(problem, plan=plan)
    replanned = simulate_reference(problem, reference, plant)
    assert replanned.position_error[-1] < 5e-4
    assert largest_rotation(replanned) < 0.1
    assert reference.failed_steps == 0
    assert reference.note == ""
    assert replanned.note == ""
    once = simulate_reference(problem, plan, plant)
    assert once.position_error[-1] > 5e-3


def test_replanning_with_the_right_model_stays_near_its_plan(
    problem: opt.Problem, plan: opt.Trajectory
) -> None:
    reference = opt.Replanning(problem, plan=plan)
    run = simulate_reference(problem, reference, problem.sms)
    assert run.position_error[-1] < 5e-4
    # Each re-plan continues the descent, so the motion differs from the plan.
    largest = np.abs(plan.wheel_momentum).max()
    assert np.abs(run.wheel_momentum).max() == pytest.approx(largest, rel=0.3)


def test_the_remaining_problem_has_the_current_wheel_momenta(
    problem: opt.Problem, plan: opt.Trajectory
) -> None:
    k = 70
    rest = rest_of(
        problem, problem.sms, k * DT, plan.q[k], plan.joint_positions[k], plan.joint_rates[k], plan.q[0, :7]
    )
    assert rest.mode == "rotation-floating"
    np.testing.assert_allclose(rest.wheel_momentum, plan.wheel_momentum[k], atol=1e-12)
    np.testing.assert_allclose(rest.wheel_total, problem.wheel_total, atol=1e-12)
    assert [limit.name for limit in rest.limits] == [limit.name for limit in problem.limits]
    # The remaining problem gives the plan's remaining momenta.
    replanned = measure(rest, plan.joint_rates[k:])
    np.testing.assert_allclose(replanned.wheel_momentum, plan.wheel_momentum[k:], atol=1e-9)


def test_masses_are_estimated_from_the_linear_momentum(problem: opt.Problem) -> None:
    """Wheels exchange angular momentum, so linear momentum alone is used; thrusters change both."""
    plant = perturb(problem.sms, arm_mass=1.2)
    phase = np.linspace(0.0, np.pi, problem.steps + 1)[:, None]
    rates = np.array([0.3, 0.4, 0.5]) * np.sin(phase * [2.0, 4.0, 6.0]) * np.sin(phase)  # moves every link
    run = simulate_reference(problem, measure(problem, rates), plant)

    def estimated_factors(mode: str) -> FloatArray:
        estimate = ScaleFactors(problem.sms, mode)
        for q, v in zip(run.q[::5], run.v[::5], strict=True):
            assert not estimate.update(0.0, q, v)
        return estimate.solve()

    # The first link hardly moves relative to the base, so its mass is not identifiable.
    np.testing.assert_allclose(estimated_factors("rotation-floating")[1:3], 1.2, atol=0.03)
    np.testing.assert_array_equal(estimated_factors("rotation-flying"), np.ones(4))
    floating = ScaleFactors(problem.sms, "floating")
    for q, v in zip(run.q[::5], run.v[::5], strict=True):
        floating.update(0.0, q, v)
    assert np.abs(floating.solve()[1:3] - 1.2).max() > 0.1


@pytest.mark.parametrize("mode", ["rotation-flying", "flying"])
def test_replanning_with_thrusters_that_hold_the_base(mode: str) -> None:
    """The plant is the model in the same mode."""
    sms = ffsms.load("planar_3r")
    q0 = sms.configuration(np.radians([1.0, 1.0, 1.0]))
    problem = opt.Problem(sms, q0, TARGET, 4.0, DT, mode=mode)
    reference = opt.Replanning(problem)
    q, rates = q0, np.zeros(3)
    for k in range(problem.steps):
        v = sms.velocity(q, rates, None, mode)
        reference.observe(k * DT, q, v)
        _, rates, accelerations = reference.sample(k * DT)
        q, rates = advance(sms, q, rates, accelerations, DT, None, mode)
    error = sms.at(q).end_effector_pose.translation - TARGET
    assert np.linalg.norm(error) < 2e-3
    assert reference.note == ""


def test_replanning_compensates_the_drift_after_a_push(problem: opt.Problem, plan: opt.Trajectory) -> None:
    """The drift until the deadline exceeds 2 cm."""
    sms, k = problem.sms, len(plan.t) // 4
    t, drift = float(plan.t[k]), np.array([0.004, -0.003, 0.0])
    reference = opt.Replanning(problem, plan=plan)
    reference.observe(0.0, plan.q[0], plan.v[0])
    reference.pushed = True
    v = plan.v[k].copy()
    v[:3] += pin.Quaternion(plan.q[k, 3:7]).toRotationMatrix().T @ drift
    reference.observe(t, plan.q[k], v)
    assert reference.expected_miss < 1e-4
    current = reference._planner.current
    assert current is not None
    rest = rest_of(problem, sms, t, plan.q[k], current.joints, current.rates[0], plan.q[0, :7])
    momentum = [*(sms.arm_stack().mass * drift), 0.0, 0.0, 0.0]
    pushed = measure(replace(rest, momentum=momentum), current.rates)
    assert pushed.position_error[-1] < 2e-4
    assert np.linalg.norm((plan.duration - t) * drift) > 0.02
