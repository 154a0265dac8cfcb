"""Paths in the closed loop, re-planned with wrong masses, noise, pushes and faults."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.capture import Camera, ClientEstimate
from ffsms_pin.control import ComputedTorque
from ffsms_pin.errors import InvalidValue
from ffsms_pin.simulation import JointFault, Sensors

WITHIN = 2e-3  # [m] after the first second
DURATION = 8.0  # [s] of which two are the approach


@pytest.fixture(scope="module")
def q0(planar: Any) -> Any:
    return planar.configuration([0.3, 0.6, 0.5])


def path(begin: Any, **options: Any) -> opt.Path:
    """Return a circle of 50 mm through a position, three quarters of it in six seconds."""
    return opt.Path(
        lambda t: begin + 0.05 * np.array([np.cos(0.25 * np.pi * t) - 1.0, np.sin(0.25 * np.pi * t), 0.0]),
        approach_time=2.0,
        **options,
    )


def simulate_reference(
    planar: Any, q0: Any, reference: Any, plant: Any = None, **options: Any
) -> ffsms.Tracking:
    law = ComputedTorque(planar, K_p=100.0, K_d=20.0)
    conditions = ffsms.Conditions(**options)
    return ffsms.simulate(planar, reference, law, 5e-3, q0=q0, plant=plant, conditions=conditions)


def test_replanning_follows_a_path_with_wrong_masses(planar: Any, q0: Any) -> None:
    """With masses wrong by 20 %, a plan without re-planning leaves the path by more than 5 mm."""
    problem = opt.Problem(planar, q0, path(planar.at(q0).end_effector_pose.translation), DURATION)
    plant = ffsms.perturb(planar, arm_mass=1.2, base_mass=0.8)
    plan = opt.solve(problem)
    once = simulate_reference(planar, q0, plan, plant)
    replanned = simulate_reference(planar, q0, opt.Replanning(problem, plan=plan), plant)
    late = replanned.t >= 1.0
    assert once.position_error[late].max() > 5e-3
    assert replanned.position_error[late].max() < 0.25 * WITHIN
    assert replanned.arrived, replanned.note


def test_replanning_follows_a_path_with_noisy_late_measurements(planar: Any, q0: Any) -> None:
    """The masses are wrong too."""
    problem = opt.Problem(planar, q0, path(planar.at(q0).end_effector_pose.translation), DURATION)
    plant = ffsms.perturb(planar, arm_mass=1.2, base_mass=0.8)
    noisy = Sensors(
        joint_noise=5e-5,
        joint_rate_noise=1e-3,
        base_position_noise=1e-3,
        base_attitude_noise=5e-5,
        base_velocity_noise=1e-3,
        base_rate_noise=1e-4,
        base_latency=0.02,
    )
    run = simulate_reference(planar, q0, opt.Replanning(problem), plant, sensors=noisy, estimator=True)
    assert run.position_error[run.t >= 1.0].max() < WITHIN
    assert run.arrived, run.note


def test_a_path_on_the_base_is_followed_and_its_end_kept(planar: Any, q0: Any) -> None:
    base = pin.XYZQUATToSE3(q0[:7])
    begin = base.actInv(planar.at(q0).end_effector_pose.translation)
    problem = opt.Problem(planar, q0, path(begin, frame="base"), DURATION)
    plant = ffsms.perturb(planar, arm_mass=1.2, base_mass=0.8)
    run = simulate_reference(planar, q0, opt.Replanning(problem, hold=1.0), plant)
    assert run.t[-1] == pytest.approx(DURATION + 1.0)
    assert run.position_error[run.t >= 1.0].max() < WITHIN
    assert run.position_error[-1] < 1e-4


@pytest.mark.parametrize("mode", ["floating", "rotation-flying", "flying"])
def test_replanning_of_a_path_accepts_a_push(planar: Any, q0: Any, mode: str) -> None:
    """A push changes the momentum of the uncontrolled base coordinates alone."""
    problem = opt.Problem(
        planar, q0, path(planar.at(q0).end_effector_pose.translation), DURATION, 0.05, mode=mode
    )
    reference = opt.Replanning(problem, options=opt.ReplanOptions(period=0.05))
    v = np.zeros(planar.nv)
    reference.observe(0.0, q0, v)
    reference.pushed = True
    v[:6] = 1e-3
    reference.observe(0.05, q0, v)
    assert np.isfinite(reference.sample(0.1)[1]).all()


def test_tracking_a_path_starts_at_the_measured_state(planar: Any, q0: Any) -> None:
    """The approach of `StepPlanner.track` leads from the measured state to the path."""
    begin = planar.at(q0).end_effector_pose.translation
    away = planar.configuration([0.3, 0.6, 0.4])
    reference = opt.StepPlanner(planar, dt=0.01).track(path(begin), DURATION)
    run = simulate_reference(planar, away, reference)
    assert run.arrived, run.note
    assert run.position_error[run.t >= 2.5].max() < WITHIN
    assert run.position_error[0] < 1e-6


def test_a_path_is_followed_after_a_joint_locks(planar: Any, q0: Any) -> None:
    """Two joints suffice for positions in the plane."""
    problem = opt.Problem(planar, q0, path(planar.at(q0).end_effector_pose.translation), DURATION)
    fault = JointFault(4.0, "joint_3")
    run = simulate_reference(planar, q0, opt.Replanning(problem), events=fault)
    assert run.position_error[run.t >= 5.0].max() < WITHIN, run.note  # the sudden stop swings the arm


def test_replanning_a_fastest_path_requires_its_plan(planar: Any, q0: Any) -> None:
    """The plan has the time law of the path."""
    begin = planar.at(q0).end_effector_pose.translation
    line = opt.Path([begin, begin + np.array([-0.05, 0.0, 0.0])], timing="fastest")
    problem = opt.Problem(planar, q0, line, DURATION)
    with pytest.raises(InvalidValue, match="timing must be planned before re-planning"):
        opt.Replanning(problem)
    plan = opt.solve(problem)
    assert plan.problem is not None
    run = simulate_reference(planar, q0, opt.Replanning(plan.problem, plan=plan))
    assert run.t[-1] == pytest.approx(plan.duration, abs=5e-3)
    assert plan.duration < 0.5 * DURATION
    assert run.position_error.max() < WITHIN


@pytest.mark.parametrize(
    ("option", "value"), [("search_again", 2.0), ("dead_band", 1e-4), ("settle", 0.2), ("rate_reserve", 0.1)]
)
def test_options_without_effect_on_paths_are_refused(planar: Any, q0: Any, option: str, value: float) -> None:
    """Weights of single steps are refused too."""
    problem = opt.Problem(planar, q0, path(planar.at(q0).end_effector_pose.translation), DURATION)
    with pytest.raises(InvalidValue, match=f"{option} is not for an opt.Path"):
        opt.Replanning(problem, options=opt.ReplanOptions(**{option: value}))
    with pytest.raises(InvalidValue, match=r"weights must be left out for an opt\.Path"):
        opt.Replanning(problem, weights=opt.StepWeights())


def test_replanning_follows_the_newest_estimate_of_a_client(planar: Any, q0: Any) -> None:
    """The path moves with the estimate from the first measurement on."""
    pose = planar.at(q0).end_effector_pose
    true = ffsms.Client(20.0, [1.0, 1.0, 1.0], pose=pose, twist=[0.002, 0.001, 0.0, 0.0, 0.0, 0.01])
    wrong_pose = pin.SE3(np.eye(3), pose.translation + np.array([0.005, -0.004, 0.0]))
    first = ffsms.Client(20.0, [1.0, 1.0, 1.0], pose=wrong_pose, twist=[0.0, 0.0, 0.0, 0.0, 0.0, 0.012])
    camera = Camera(position_noise=0.005, velocity_noise=0.005, rate_noise=0.005)
    estimate = ClientEstimate(first, 0.0, camera)

    class MeasuringReplanning(opt.Replanning):
        """A re-planning with two measurements of the client a second."""

        last_measurement = 0.0

        def observe(self, t: float, q: Any, v: Any) -> None:
            if t >= self.last_measurement + 0.5:
                self.last_measurement = t
                measured = ffsms.Client(20.0, [1.0, 1.0, 1.0], pose=true.pose(t), twist=true.twist(t))
                estimate.observe(measured, t)
            super().observe(t, q, v)

    problem = opt.Problem(planar, q0, path(np.zeros(3), frame=estimate), DURATION)
    run = simulate_reference(planar, q0, MeasuringReplanning(problem))
    goal = opt.Problem(planar, q0, path(np.zeros(3), frame=true), DURATION).goal
    errors = [
        np.linalg.norm(goal.place(t).position - planar.at(q).end_effector_pose.translation)
        for t, q in zip(run.t[::20], run.q[::20], strict=True)
    ]
    assert errors[20] > 3e-3  # half way through the approach, after the first measurement
    assert max(errors[60:]) < WITHIN
