"""Re-planning in the closed loop: wrong models, faults, failed steps, continuous commands."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from motions import START
from numpy.typing import NDArray
from replanned import CASES, run

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.control import ComputedTorque
from ffsms_pin.opt.replan.rest import JointPlan, RestPlanner
from ffsms_pin.opt.step.stepper import Step, Stepper
from ffsms_pin.simulation import JointFault, Observer, Sensors, perturb, random_plants, simulate

Array = NDArray[np.float64]


class RecordedReference(Observer):
    """A reference that records its samples at every planning step."""

    def __init__(self, inner: opt.Replanning) -> None:
        self.inner, self.duration, self.target, self.momentum = (
            inner,
            inner.duration,
            inner.target,
            inner.momentum,
        )
        self.t: list[float] = []
        self.samples: list[tuple[Array, Array, Array]] = []
        self.ages: list[float] = []
        self.modes: list[str] = []

    def sample(self, t: float) -> tuple[Array, Array, Array]:
        """Return the sample of the reference."""
        return self.inner.sample(t)

    def observe(self, t: float, q: Array, v: Array) -> None:
        """Pass on the observation and record the sample."""
        self.inner.observe(t, q, v)
        self.t.append(t)
        self.samples.append(self.inner.sample(t))
        self.ages.append(self.inner.plan_age)
        self.modes.append(self.inner.mode)

    def joint_failed(self, joint: int, locked: bool) -> None:
        """Pass on the fault."""
        self.inner.joint_failed(joint, locked)


# The masses are at the bounds of their range.
@pytest.mark.parametrize(
    ("case", "arm", "base"), [(2, 1.2, 0.9), (2, 1.0, 0.9), (2, 0.8, 1.1), (1, 1.2, 0.9), (1, 0.8, 1.1)]
)
def test_replanning_with_wrong_masses_ends_within_2_mm(
    case: int, arm: float, base: float, planar: ffsms.SpaceManipulator
) -> None:
    plant = perturb(planar, arm_mass=arm, base_mass=base)
    reference, tracking = run(planar, CASES[case], plant=plant)
    assert tracking.position_error[-1] < 2e-3
    assert reference.failed_steps == 0
    assert reference.note == ""
    assert planar.limits.violation(tracking.q[:, 7:]).max() < 1e-3
    assert (np.abs(tracking.v[:, 6:]) < 1.05 * planar.limits.velocity).all()


@pytest.mark.long
@pytest.mark.slow
def test_replanning_with_random_plants_ends_within_2_mm(planar: ffsms.SpaceManipulator) -> None:
    # A case of benchmarks/reaching.py.
    for plant in random_plants(planar, np.random.default_rng(7), 3):
        _, tracking = run(planar, CASES[2], plant=plant)
        assert tracking.position_error[-1] < 2e-3


@pytest.mark.long
@pytest.mark.slow
def test_replanning_of_a_spatial_arm_with_random_plants() -> None:
    # Case 1 of benchmarks/reaching.py for a Panda on a satellite, where steps alone meet a joint limit.
    sms = ffsms.load("satellite_panda")
    q0 = sms.configuration(0.5 * (np.maximum(sms.limits.lower, -3.0) + np.minimum(sms.limits.upper, 3.0)))
    target = sms.at(q0).end_effector_pose.translation + np.array([-0.15, 0.35, -0.25])
    for plant in list(random_plants(sms, np.random.default_rng(1), 16))[9::6]:
        reference = opt.StepPlanner(sms, dt=0.02).track(target, 12.0)
        tracking = simulate(sms, reference, ComputedTorque(sms, 100.0, 20.0), dt=5e-3, q0=q0, plant=plant)
        assert tracking.position_error[-1] < 2e-3
        assert reference.failed_steps == 0
        # The move is 0.5 m in 12 s, so the rates stay small.
        assert np.abs(tracking.v[:, 6:]).max() < 0.5


@pytest.mark.long
@pytest.mark.slow
def test_a_plan_without_replanning_misses(planar: ffsms.SpaceManipulator) -> None:
    plant = perturb(planar, arm_mass=1.2)
    plan = opt.plan(planar, planar.configuration(START), CASES[2], 12.0, dt=0.02)
    once = simulate(planar, plan, ComputedTorque(planar, 100.0, 20.0), dt=2e-3, plant=plant)
    problem = opt.Problem(planar, planar.configuration(START), CASES[2], 12.0, 0.02)
    reference = opt.Replanning(problem, plan=plan)
    law = ComputedTorque(planar, 100.0, 20.0)
    replanned_run = simulate(planar, reference, law, dt=2e-3, q0=plan.q[0], plant=plant)
    assert once.position_error[-1] > 0.01
    assert replanned_run.position_error[-1] < 2e-3


def test_commands_have_no_jumps_and_keep_the_limits(planar: ffsms.SpaceManipulator) -> None:
    recorded = RecordedReference(opt.StepPlanner(planar, dt=0.02).track(CASES[2], 6.0, 1.0))
    plant = perturb(planar, arm_mass=1.2, base_mass=0.9)
    law = ComputedTorque(planar, 100.0, 20.0)
    simulate(planar, recorded, law, dt=5e-3, q0=planar.configuration(START), plant=plant)
    positions, rates, accelerations = (np.array(x) for x in zip(*recorded.samples, strict=True))
    limits, h = planar.limits, np.diff(recorded.t)[:, None]
    np.testing.assert_allclose(np.diff(positions, axis=0), 0.5 * h * (rates[1:] + rates[:-1]), atol=1e-12)
    np.testing.assert_allclose(np.diff(rates, axis=0), h * accelerations[:-1], atol=1e-12)
    assert (np.abs(accelerations) <= limits.acceleration + 1e-9).all()
    assert (np.abs(rates) <= limits.velocity + 1e-9).all()
    assert limits.violation(positions).max() == 0.0
    # The plan is never older than the period until single steps take over.
    ages, modes = np.array(recorded.ages), np.array(recorded.modes)
    assert ages[0] == 0.0
    assert 0.05 < ages[modes == "plan"].max() < recorded.inner.options.period
    assert list(dict.fromkeys(recorded.modes)) == ["plan", "hold"]
    assert ages[-1] > 1.0


def test_replanning_with_the_right_model_stays_near_the_plan(planar: ffsms.SpaceManipulator) -> None:
    plan = opt.plan(planar, planar.configuration(START), CASES[2], 8.0, dt=0.02)
    reference = opt.Replanning(opt.Problem(planar, plan.q[0], CASES[2], 8.0, 0.02), plan=plan)
    law = ComputedTorque(planar, 100.0, 20.0)
    tracking = simulate(planar, reference, law, dt=5e-3, q0=plan.q[0])
    planned = np.array([plan.sample(t)[0] for t in tracking.t])
    # Each re-plan continues the descent on a coarser spline: measured 0.11 rad of 3 rad.
    assert np.abs(tracking.q[:, 7:] - planned).max() < 0.15
    assert np.abs(np.diff(plan.joint_positions, axis=0)).sum() > 1.0


@pytest.mark.parametrize("kind", ["locked", "limp"])
def test_replanning_continues_after_a_joint_fault(kind: Any, planar: ffsms.SpaceManipulator) -> None:
    fault = JointFault(2.0, "joint_3", kind)
    reference, tracking = run(planar, CASES[1], events=fault)
    assert "joint_3" in reference.note
    if kind == "locked":
        assert tracking.position_error[-1] < 2e-3
        np.testing.assert_array_equal(tracking.v[401:, 8], 0.0)
        assert reference.sample(6.0)[1][2] == 0.0
    else:
        assert np.isfinite(tracking.position_error).all()


def test_motions_that_violate_a_limit_by_far_are_not_executed(
    planar: ffsms.SpaceManipulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All plans from 2 to 4 s violate a limit; the arm stops, then continues."""
    original = RestPlanner.plan

    def plan_with_excess(self: RestPlanner, now: float, *state: Any) -> JointPlan:
        plan = original(self, now, *state)
        self.current = dataclasses.replace(plan, excess=10.0 if 2.0 <= now < 4.0 else plan.excess)
        return self.current

    monkeypatch.setattr(RestPlanner, "plan", plan_with_excess)
    q0 = planar.configuration(START)
    reference = opt.Replanning(opt.Problem(planar, q0, CASES[1], 10.0, 0.02))
    tracking = simulate(planar, reference, ComputedTorque(planar, 100.0, 20.0), dt=5e-3, q0=q0)
    rates = np.abs(tracking.v[:, 6:]).max(axis=1)
    k = int(np.searchsorted(tracking.t, 4.0))
    assert rates[k - 20 : k - 2].max() < 1e-3 < 0.02 < rates[: k // 2].max()
    assert "the arm held still for" in reference.note
    assert tracking.position_error[-1] < 2e-3
    assert planar.limits.violation(tracking.q[:, 7:]).max() < 1e-3


@pytest.mark.slow
def test_the_note_of_a_missed_target_names_the_fault(planar: ffsms.SpaceManipulator) -> None:
    reference, tracking = run(planar, CASES[2], events=[JointFault(1.0, joint) for joint in (0, 1, 2)])
    assert not tracking.arrived
    assert reference.note in tracking.note
    assert "'joint_1' has failed" in reference.note


def test_the_expected_miss_is_reported(planar: ffsms.SpaceManipulator) -> None:
    faults = [JointFault(1.0, joint) for joint in ("joint_1", "joint_2", "joint_3")]
    reference, tracking = run(planar, CASES[2], events=faults)
    assert tracking.position_error[-1] > 0.5
    assert "missed by" in reference.note
    assert reference.expected_miss == pytest.approx(tracking.position_error[-1], abs=1e-3)


def test_replanning_keeps_locked_joints(planar: ffsms.SpaceManipulator) -> None:
    q0 = planar.configuration(START)
    problem = opt.Problem(planar, q0, CASES[1], 8.0, 0.02, locked=["joint_3"])
    reference = opt.Replanning(problem)
    tracking = simulate(planar, reference, ComputedTorque(planar, 100.0, 20.0), dt=5e-3, q0=q0)
    assert tracking.position_error[-1] < 2e-3
    assert np.ptp(tracking.q[:, 9]) < 1e-3
    assert np.ptp(tracking.q[:, 8]) > 0.1
    assert reference.note == ""


def test_replanning_with_late_and_noisy_sensors(planar: ffsms.SpaceManipulator) -> None:
    sensors = Sensors(
        joint_resolution=2e-5,
        base_position_noise=2e-4,
        base_attitude_noise=2e-4,
        base_velocity_noise=5e-4,
        base_rate_noise=5e-4,
        base_latency=0.02,
    )
    plant = perturb(planar, arm_mass=1.1)
    _, tracking = run(planar, CASES[1], plant=plant, sensors=sensors)
    assert tracking.position_error[-1] < 2e-3


def test_failed_steps_are_counted_and_stop_the_simulation(
    planar: ffsms.SpaceManipulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    original = Stepper.advance

    def advance(self: Any, *arguments: Any, **options: Any) -> Step:
        step = original(self, *arguments, **options)
        if "prefer" in options or len(arguments) > 5:  # a step in the closed loop
            loop_steps.append(step)
        return dataclasses.replace(step, solved=len(loop_steps) not in failing)

    monkeypatch.setattr(Stepper, "advance", advance)
    # Plans within the limits need no QP; steps are solved after the deadline.
    loop_steps: list[Step] = []
    failing = range(3, 5)
    reference, tracking = run(planar, CASES[1], hold=1.0)
    assert reference.failed_steps == 2
    assert reference.failed_in_a_row == 0
    assert "braked in 2 steps" in reference.note
    assert tracking.t[-1] == 7.0
    loop_steps.clear()
    failing = range(3, 1000)
    _, tracking = run(planar, CASES[1], hold=1.0)
    assert "10 planning steps in a row" in tracking.stopped
