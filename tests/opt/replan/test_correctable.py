"""Correctable errors, the dead band, the jerk limit, and momentum from noisy samples."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from motions import START
from numpy.typing import NDArray

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.control import ComputedTorque
from ffsms_pin.errors import FfsmsError, InvalidValue
from ffsms_pin.opt.replan.correctable import Correctable
from ffsms_pin.opt.replan.learning import ScaleFactors
from ffsms_pin.opt.replan.options import ReplanOptions
from ffsms_pin.robot.base_motion import roll_out
from ffsms_pin.simulation import Observer, Tracking, perturb, simulate

Array = NDArray[np.float64]


def test_a_spatial_arm_can_correct_everything() -> None:
    sms = ffsms.load("satellite_panda")
    correctable, goal = Correctable(sms), opt.Position([1.0, 2.0, 3.0])
    assert correctable.everything
    q = sms.configuration(0.5 * (sms.limits.lower + sms.limits.upper))
    assert correctable.goal(goal, q, 0.0) == (goal, 0.0)


def test_a_planar_arm_corrects_errors_in_its_plane(planar: ffsms.SpaceManipulator) -> None:
    correctable = Correctable(planar)
    # The base is rotated, and the arm's plane with it.
    base = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.5, 0.2), np.array([0.1, 0.2, 0.3]))
    q = planar.configuration(START, base)
    here = planar.at(q).end_effector_pose
    across, along = base.rotation[:, 2], base.rotation @ np.array([0.6, 0.8, 0.0])
    target = here.translation + 0.2 * along + 0.004 * across
    turned = here.rotation @ pin.rpy.rpyToMatrix(0.0, 0.0, 0.3)
    goal, miss = correctable.goal(opt.Pose(pin.SE3(turned, target)), q, 1.0)
    assert miss == pytest.approx(0.004)
    place = goal.place(1.0)
    np.testing.assert_allclose(place.position, here.translation + 0.2 * along, atol=1e-12)
    assert place.rotation is not None
    np.testing.assert_allclose(place.rotation, turned, atol=1e-12)
    # A tilt out of the plane is not corrected.
    tilted = opt.Pose(pin.SE3(turned @ pin.rpy.rpyToMatrix(1e-3, 0.0, 0.0), target))
    place = correctable.goal(tilted, q, 1.0)[0].place(1.0)
    assert place.rotation is not None
    assert np.abs(pin.log3(place.rotation @ here.rotation.T) @ np.c_[along]).max() < 1e-9
    # Goals in the plane are returned unchanged.
    plain = opt.Position(here.translation + 0.1 * along)
    assert correctable.goal(plain, q, 1.0) == (plain, 0.0)


def test_the_miss_of_a_target_off_the_plane_is_reported(planar: ffsms.SpaceManipulator) -> None:
    reference = opt.StepPlanner(planar, dt=0.05).track([0.9, 0.3, 0.01], 4.0)
    law, q0 = ComputedTorque(planar, 100.0, 20.0), planar.configuration(START)
    tracking = simulate(planar, reference, law, dt=5e-3, q0=q0)
    assert tracking.position_error[-1] == pytest.approx(0.01, abs=1e-4)
    assert reference.expected_miss == pytest.approx(0.01, abs=1e-3)
    assert "missed by 0.01" in reference.note


def test_the_dead_band_has_two_edges() -> None:
    with_band, rests = ReplanOptions(dead_band=1e-3), [False]
    for distance in (2e-3, 0.9e-3, 0.3e-3, 0.9e-3, 1.1e-3, 0.9e-3):
        rests.append(with_band.rests(distance, None, rests[-1]))
    assert rests[1:] == [False, False, True, True, False, False]
    options = ReplanOptions()
    assert not options.rests(0.0, None, False)
    assert options.band(None) == 0.0
    assert [options.band(noise) for noise in (0.0, 1e-4, 1.0)] == pytest.approx([1e-4, 3e-4, 1e-3])
    assert ReplanOptions(dead_band=5e-3).band(None) == 5e-3


def simulate_commands(planar: ffsms.SpaceManipulator, **options: object) -> tuple[Array, Tracking]:
    """Return commanded accelerations (N, 3) by planning step on a wrong plant, and the recording."""
    q0 = planar.configuration(START)
    plan = opt.plan(planar, q0, [0.75, 0.5, 0.0], 6.0, dt=0.02, method="resolved-rate")
    problem = opt.Problem(planar, q0, plan.target, 6.0, 0.02)
    replan_options = ReplanOptions(period=0.3, **options)  # type: ignore[arg-type]
    reference = opt.Replanning(problem, 1.0, plan, replan_options)
    law, plant = ComputedTorque(planar, 100.0, 20.0), perturb(planar, arm_mass=1.2)
    accelerations: list[Array] = []

    class CommandRecorder(Observer):
        duration, target, momentum = reference.duration, reference.target, None
        sample = staticmethod(reference.sample)

        @staticmethod
        def observe(t: float, q: Array, v: Array) -> None:
            reference.observe(t, q, v)
            if not accelerations or round(t / 0.02, 6) == round(t / 0.02):
                accelerations.append(reference.sample(t)[2])

    tracking = simulate(planar, CommandRecorder(), law, dt=5e-3, q0=q0, plant=plant)
    return np.array(accelerations), tracking


@pytest.mark.slow
def test_commands_keep_a_jerk_limit_on_request(planar: ffsms.SpaceManipulator) -> None:
    free, _ = simulate_commands(planar)
    limited, tracking = simulate_commands(planar, jerk=[4.0, 4.0, 5.0])
    jerk = np.abs(np.diff(limited, axis=0)).max(axis=0) / 0.02
    assert (jerk <= np.array([4.0, 4.0, 5.0]) + 1e-4).all()
    assert np.abs(np.diff(free, axis=0)).max() / 0.02 > 10.0
    assert tracking.position_error[-1] < 2e-3
    assert (np.abs(limited) <= planar.limits.acceleration + 1e-9).all()


def test_wrong_numbers_of_replanning_are_refused(
    planar: ffsms.SpaceManipulator, refused: Callable[..., FfsmsError]
) -> None:
    problem = opt.Problem(planar, planar.configuration(START), [0.75, 0.5, 0.0], 6.0, 0.02)
    wrong: dict[str, Any] = {"jerk": [1.0, 2.0], "dead_band": -1.0}
    for name, value in wrong.items():
        make_options = partial(ReplanOptions, **{name: value})
        refused(
            lambda make_options=make_options: opt.Replanning(problem, options=make_options()),
            InvalidValue,
            name,
        )


@pytest.mark.parametrize("noisy", [True, False])
def test_a_noisy_estimate_weights_the_first_sample_as_any_other(
    noisy: bool, planar: ffsms.SpaceManipulator
) -> None:
    plant = perturb(planar, arm_mass=[1.2, 0.9, 1.1])
    rng, steps = np.random.default_rng(3), 400
    accelerations = 0.4 * np.sin(np.linspace(0.0, 12.0, steps)[:, None] * rng.uniform(0.5, 2.0, 3))
    q, rates = roll_out(plant, plant.configuration(np.ones(3)), np.zeros(3), accelerations, 0.02, None)
    estimate = ScaleFactors(planar)
    estimate.noisy = noisy
    for k, (configuration, u) in enumerate(zip(q, rates, strict=True)):
        v = plant.velocity(configuration, u)
        if k == 0:
            v[:6] += 3e-3  # three standard deviations of one sample
        estimate.update(0.0, configuration, v)
    error = np.abs(estimate.solve() - [1.2, 0.9, 1.1, 1.0]).max()
    assert error < 0.1 if noisy else error > 0.15
