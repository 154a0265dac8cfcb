"""Re-planning in the loop: wrong models, faults, failed steps, commands without jumps."""

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


class Watched(Observer):
    """A reference, and what it said at every planning step."""

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
        """The reference's."""
        return self.inner.sample(t)

    def observe(self, t: float, q: Array, v: Array) -> None:
        """The reference's, written down."""
        self.inner.observe(t, q, v)
        self.t.append(t)
        self.samples.append(self.inner.sample(t))
        self.ages.append(self.inner.plan_age)
        self.modes.append(self.inner.mode)

    def joint_failed(self, joint: int, locked: bool) -> None:
        """The reference's."""
        self.inner.joint_failed(joint, locked)


# Corners of the range.
@pytest.mark.parametrize(
    ("case", "arm", "base"), [(2, 1.2, 0.9), (2, 1.0, 0.9), (2, 0.8, 1.1), (1, 1.2, 0.9), (1, 0.8, 1.1)]
)
def test_wrong_masses_end_within_two_millimetres(
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
def test_random_plants_end_within_two_millimetres(planar: ffsms.SpaceManipulator) -> None:
    # A case of benchmarks/reaching.py.
    for plant in random_plants(planar, np.random.default_rng(7), 3):
        _, tracking = run(planar, CASES[2], plant=plant)
        assert tracking.position_error[-1] < 2e-3


@pytest.mark.long
@pytest.mark.slow
def test_random_plants_of_a_spatial_arm() -> None:
    # Case 1 of benchmarks/reaching.py for a Panda on a satellite, where steps alone meet a joint limit.
    sms = ffsms.load("satellite_panda")
    q0 = sms.configuration(0.5 * (np.maximum(sms.limits.lower, -3.0) + np.minimum(sms.limits.upper, 3.0)))
    target = sms.at(q0).end_effector_pose.translation + np.array([-0.15, 0.35, -0.25])
    for plant in list(random_plants(sms, np.random.default_rng(1), 16))[9::6]:
        reference = opt.StepPlanner(sms, dt=0.02).track(target, 12.0)
        tracking = simulate(sms, reference, ComputedTorque(sms, 100.0, 20.0), dt=5e-3, q0=q0, plant=plant)
        assert tracking.position_error[-1] < 2e-3
        assert reference.failed_steps == 0
        # Nothing makes it hurry: half a metre in 12 s.
        assert np.abs(tracking.v[:, 6:]).max() < 0.5


@pytest.mark.long
@pytest.mark.slow
def test_open_loop_plan_misses_where_replanning_does_not(planar: ffsms.SpaceManipulator) -> None:
    plant = perturb(planar, arm_mass=1.2)
    plan = opt.plan(planar, planar.configuration(START), CASES[2], 12.0, dt=0.02)
    once = simulate(planar, plan, ComputedTorque(planar, 100.0, 20.0), dt=2e-3, plant=plant)
    problem = opt.Problem(planar, planar.configuration(START), CASES[2], 12.0, 0.02)
    reference = opt.Replanning(problem, plan=plan)
    law = ComputedTorque(planar, 100.0, 20.0)
    again = simulate(planar, reference, law, dt=2e-3, q0=plan.q[0], plant=plant)
    assert once.position_error[-1] > 0.01
    assert again.position_error[-1] < 2e-3


def test_commands_have_no_jumps_and_keep_the_limits(planar: ffsms.SpaceManipulator) -> None:
    gradient_watch = Watched(opt.StepPlanner(planar, dt=0.02).track(CASES[2], 6.0, 1.0))
    plant = perturb(planar, arm_mass=1.2, base_mass=0.9)
    law = ComputedTorque(planar, 100.0, 20.0)
    simulate(planar, gradient_watch, law, dt=5e-3, q0=planar.configuration(START), plant=plant)
    positions, rates, accelerations = (np.array(x) for x in zip(*gradient_watch.samples, strict=True))
    limits, h = planar.limits, np.diff(gradient_watch.t)[:, None]
    np.testing.assert_allclose(np.diff(positions, axis=0), 0.5 * h * (rates[1:] + rates[:-1]), atol=1e-12)
    np.testing.assert_allclose(np.diff(rates, axis=0), h * accelerations[:-1], atol=1e-12)
    assert (np.abs(accelerations) <= limits.acceleration + 1e-9).all()
    assert (np.abs(rates) <= limits.velocity + 1e-9).all()
    assert limits.violation(positions).max() == 0.0
    # It says how old its plan is: never older than the period, until steps go to the goal.
    ages, modes = np.array(gradient_watch.ages), np.array(gradient_watch.modes)
    assert ages[0] == 0.0
    assert 0.05 < ages[modes == "plan"].max() < gradient_watch.inner.options.period
    assert list(dict.fromkeys(gradient_watch.modes)) == ["plan", "hold"]
    assert ages[-1] > 1.0


def test_the_right_robot_does_what_was_planned(planar: ffsms.SpaceManipulator) -> None:
    plan = opt.plan(planar, planar.configuration(START), CASES[2], 8.0, dt=0.02)
    reference = opt.Replanning(opt.Problem(planar, plan.q[0], CASES[2], 8.0, 0.02), plan=plan)
    law = ComputedTorque(planar, 100.0, 20.0)
    tracking = simulate(planar, reference, law, dt=5e-3, q0=plan.q[0])
    planned = np.array([plan.sample(t)[0] for t in tracking.t])
    # Each re-plan goes on descending, on a coarser spline than the plan's: measured 0.11 rad of 3 rad.
    assert np.abs(tracking.q[:, 7:] - planned).max() < 0.15
    assert np.abs(np.diff(plan.joint_positions, axis=0)).sum() > 1.0


@pytest.mark.parametrize("kind", ["locked", "limp"])
def test_it_goes_on_with_what_is_left(kind: Any, planar: ffsms.SpaceManipulator) -> None:
    fault = JointFault(2.0, "joint_3", kind)
    reference, tracking = run(planar, CASES[1], events=fault)
    assert "joint_3" in reference.note
    if kind == "locked":
        assert tracking.position_error[-1] < 2e-3
        np.testing.assert_array_equal(tracking.v[401:, 8], 0.0)
        assert reference.sample(6.0)[1][2] == 0.0
    else:
        assert np.isfinite(tracking.position_error).all()


def test_motions_that_break_a_limit_by_far_are_not_flown(
    planar: ffsms.SpaceManipulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From 2 to 4 s all plans are in collision, say: the arm holds still, then goes on."""
    make = RestPlanner.plan

    def broken(self: RestPlanner, now: float, *state: Any) -> JointPlan:
        plan = make(self, now, *state)
        self.current = dataclasses.replace(plan, excess=10.0 if 2.0 <= now < 4.0 else plan.excess)
        return self.current

    monkeypatch.setattr(RestPlanner, "plan", broken)
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
def test_a_flight_that_misses_says_why(planar: ffsms.SpaceManipulator) -> None:
    reference, tracking = run(planar, CASES[2], events=[JointFault(1.0, joint) for joint in (0, 1, 2)])
    assert not tracking.arrived
    assert reference.note in tracking.note
    assert "'joint_1' has failed" in reference.note


def test_it_says_that_it_cannot(planar: ffsms.SpaceManipulator) -> None:
    faults = [JointFault(1.0, joint) for joint in ("joint_1", "joint_2", "joint_3")]
    reference, tracking = run(planar, CASES[2], events=faults)
    assert tracking.position_error[-1] > 0.5
    assert "missed by" in reference.note
    assert reference.expected_miss == pytest.approx(tracking.position_error[-1], abs=1e-3)


def test_joints_that_the_problem_locks_stay(planar: ffsms.SpaceManipulator) -> None:
    q0 = planar.configuration(START)
    problem = opt.Problem(planar, q0, CASES[1], 8.0, 0.02, locked=["joint_3"])
    reference = opt.Replanning(problem)
    tracking = simulate(planar, reference, ComputedTorque(planar, 100.0, 20.0), dt=5e-3, q0=q0)
    assert tracking.position_error[-1] < 2e-3
    assert np.ptp(tracking.q[:, 9]) < 1e-3
    assert np.ptp(tracking.q[:, 8]) > 0.1
    assert reference.note == ""


def test_late_and_noisy_sensors(planar: ffsms.SpaceManipulator) -> None:
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


def test_unsolved_steps_are_counted_and_stopped(
    planar: ffsms.SpaceManipulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = Stepper.advance

    def advance(self: Any, *arguments: Any, **named: Any) -> Step:
        step = plain(self, *arguments, **named)
        if "prefer" in named or len(arguments) > 5:  # of a step in the loop
            taken.append(step)
        return dataclasses.replace(step, solved=len(taken) not in failing)

    monkeypatch.setattr(Stepper, "advance", advance)
    # A plan that keeps the limits is followed without a programme: steps are solved after the deadline.
    taken: list[Step] = []
    failing = range(3, 5)
    reference, tracking = run(planar, CASES[1], hold=1.0)
    assert reference.failed_steps == 2
    assert reference.failed_in_a_row == 0
    assert "braked in 2 steps" in reference.note
    assert tracking.t[-1] == 7.0
    taken.clear()
    failing = range(3, 1000)
    _, tracking = run(planar, CASES[1], hold=1.0)
    assert "10 planning steps in a row" in tracking.stopped
