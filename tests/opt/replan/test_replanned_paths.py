"""Paths in the loop: wrong masses and noise, followed by re-planning."""

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


def path(begin: Any, **words: Any) -> opt.Path:
    """Return a circle of 50 mm through a position, three quarters of it in six seconds."""
    return opt.Path(
        lambda t: begin + 0.05 * np.array([np.cos(0.25 * np.pi * t) - 1.0, np.sin(0.25 * np.pi * t), 0.0]),
        approach_time=2.0,
        **words,
    )


def flown(planar: Any, q0: Any, reference: Any, plant: Any = None, **words: Any) -> ffsms.Tracking:
    law = ComputedTorque(planar, K_p=100.0, K_d=20.0)
    conditions = ffsms.Conditions(**words)
    return ffsms.simulate(planar, reference, law, 5e-3, q0=q0, plant=plant, conditions=conditions)


def test_wrong_masses(planar: Any, q0: Any) -> None:
    """Masses wrong by 20 %: a plan made once leaves the path by centimetres, re-planning keeps it."""
    problem = opt.Problem(planar, q0, path(planar.at(q0).end_effector_pose.translation), DURATION)
    plant = ffsms.perturb(planar, arm_mass=1.2, base_mass=0.8)
    plan = opt.solve(problem)
    once = flown(planar, q0, plan, plant)
    again = flown(planar, q0, opt.Replanning(problem, plan=plan), plant)
    late = again.t >= 1.0
    assert once.position_error[late].max() > 5e-3
    assert again.position_error[late].max() < 0.25 * WITHIN
    assert again.arrived, again.note


def test_noise(planar: Any, q0: Any) -> None:
    """Noisy, late measurements of the base, and wrong masses."""
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
    run = flown(planar, q0, opt.Replanning(problem), plant, sensors=noisy, estimator=True)
    assert run.position_error[run.t >= 1.0].max() < WITHIN
    assert run.arrived, run.note


def test_on_the_base_and_held(planar: Any, q0: Any) -> None:
    """A path that rides on the base; after the deadline its end is held."""
    base = pin.XYZQUATToSE3(q0[:7])
    begin = base.actInv(planar.at(q0).end_effector_pose.translation)
    problem = opt.Problem(planar, q0, path(begin, frame="base"), DURATION)
    plant = ffsms.perturb(planar, arm_mass=1.2, base_mass=0.8)
    run = flown(planar, q0, opt.Replanning(problem, hold=1.0), plant)
    assert run.t[-1] == pytest.approx(DURATION + 1.0)
    assert run.position_error[run.t >= 1.0].max() < WITHIN
    assert run.position_error[-1] < 1e-4


@pytest.mark.parametrize("mode", ["floating", "rotation-flying", "flying"])
def test_a_push_during_a_path(planar: Any, q0: Any, mode: str) -> None:
    """A push may change the momentum of the free part of the base's motion only."""
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


def test_a_start_that_is_measured(planar: Any, q0: Any) -> None:
    """`StepPlanner.track` begins wherever the robot is: the approach leads from there."""
    begin = planar.at(q0).end_effector_pose.translation
    away = planar.configuration([0.3, 0.6, 0.4])
    reference = opt.StepPlanner(planar, dt=0.01).track(path(begin), DURATION)
    run = flown(planar, away, reference)
    assert run.arrived, run.note
    assert run.position_error[run.t >= 2.5].max() < WITHIN
    assert run.position_error[0] < 1e-6


def test_a_joint_that_locks(planar: Any, q0: Any) -> None:
    """Two joints are enough for a position: the path is kept without the third."""
    problem = opt.Problem(planar, q0, path(planar.at(q0).end_effector_pose.translation), DURATION)
    fault = JointFault(4.0, "joint_3")
    run = flown(planar, q0, opt.Replanning(problem), events=fault)
    assert run.position_error[run.t >= 5.0].max() < WITHIN, (
        run.note
    )  # it stops all at once, which swings the arm


def test_fastest_path_needs_its_plan(planar: Any, q0: Any) -> None:
    """The times of the path are those of the plan; without it the path would be followed at an even speed."""
    begin = planar.at(q0).end_effector_pose.translation
    line = opt.Path([begin, begin + np.array([-0.05, 0.0, 0.0])], timing="fastest")
    problem = opt.Problem(planar, q0, line, DURATION)
    with pytest.raises(InvalidValue, match="timing must be planned before re-planning"):
        opt.Replanning(problem)
    plan = opt.solve(problem)
    assert plan.problem is not None
    run = flown(planar, q0, opt.Replanning(plan.problem, plan=plan))
    assert run.t[-1] == pytest.approx(plan.duration, abs=5e-3)
    assert plan.duration < 0.5 * DURATION
    assert run.position_error.max() < WITHIN


@pytest.mark.parametrize(
    ("option", "value"), [("search_again", 2.0), ("dead_band", 1e-4), ("settle", 0.2), ("rate_reserve", 0.1)]
)
def test_options_that_no_path_has(planar: Any, q0: Any, option: str, value: float) -> None:
    """Each is refused by its name, as weights of single steps are."""
    problem = opt.Problem(planar, q0, path(planar.at(q0).end_effector_pose.translation), DURATION)
    with pytest.raises(InvalidValue, match=f"{option} is not for an opt.Path"):
        opt.Replanning(problem, options=opt.ReplanOptions(**{option: value}))
    with pytest.raises(InvalidValue, match=r"weights must be left out for an opt\.Path"):
        opt.Replanning(problem, weights=opt.StepWeights())


def test_newest_estimate_of_a_client(planar: Any, q0: Any) -> None:
    """A client that is measured better on the way takes the path with it, from the first look on."""
    pose = planar.at(q0).end_effector_pose
    true = ffsms.Client(20.0, [1.0, 1.0, 1.0], pose=pose, twist=[0.002, 0.001, 0.0, 0.0, 0.0, 0.01])
    off = pin.SE3(np.eye(3), pose.translation + np.array([0.005, -0.004, 0.0]))
    first = ffsms.Client(20.0, [1.0, 1.0, 1.0], pose=off, twist=[0.0, 0.0, 0.0, 0.0, 0.0, 0.012])
    camera = Camera(position_noise=0.005, velocity_noise=0.005, rate_noise=0.005)
    estimate = ClientEstimate(first, 0.0, camera)

    class Watching(opt.Replanning):
        """A re-planning that takes in what it sees twice a second."""

        looked = 0.0

        def observe(self, t: float, q: Any, v: Any) -> None:
            if t >= self.looked + 0.5:
                self.looked = t
                seen = ffsms.Client(20.0, [1.0, 1.0, 1.0], pose=true.pose(t), twist=true.twist(t))
                estimate.observe(seen, t)
            super().observe(t, q, v)

    problem = opt.Problem(planar, q0, path(np.zeros(3), frame=estimate), DURATION)
    run = flown(planar, q0, Watching(problem))
    wanted = opt.Problem(planar, q0, path(np.zeros(3), frame=true), DURATION).goal
    missed = [
        np.linalg.norm(wanted.place(t).position - planar.at(q).end_effector_pose.translation)
        for t, q in zip(run.t[::20], run.q[::20], strict=True)
    ]
    assert missed[20] > 3e-3  # where the first look has it, half way through the approach
    assert max(missed[60:]) < WITHIN
