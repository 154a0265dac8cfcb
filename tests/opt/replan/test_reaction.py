"""Estimates of mass factors from the motion."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.control import ComputedTorque
from ffsms_pin.opt.replan.learning import ScaleFactors
from ffsms_pin.robot.base_motion import roll_out
from ffsms_pin.simulation import Wrench, perturb


@pytest.mark.parametrize("momentum", [np.zeros(6), np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.3])])
def test_mass_factors_are_estimated_from_the_motion(
    momentum: np.ndarray, planar: ffsms.SpaceManipulator
) -> None:
    plant = perturb(planar, arm_mass=[1.2, 0.9, 1.1], base_mass=0.9, base_inertia=1.05)
    rng = np.random.default_rng(3)
    steps = 400
    accelerations = 0.4 * np.sin(np.linspace(0.0, 12.0, steps)[:, None] * rng.uniform(0.5, 2.0, 3))
    q, rates = roll_out(plant, plant.configuration(np.ones(3)), np.zeros(3), accelerations, 0.02, momentum)
    estimate = ScaleFactors(planar)
    jumps = [estimate.update(0.0, a, plant.velocity(a, u, momentum)) for a, u in zip(q, rates, strict=True)]
    assert not any(jumps)
    robot = estimate.robot()
    # Momentum determines ratios alone; the base's mass is the unit.
    np.testing.assert_allclose(estimate.factors, np.array([1.2, 0.9, 1.1, 1.05]) / 0.9, atol=0.05)
    assert np.abs(planar.at(q[200]).C_bm - plant.at(q[200]).C_bm).max() > 9e-4
    np.testing.assert_allclose(robot.at(q[200]).C_bm, plant.at(q[200]).C_bm, atol=2e-4)
    assert (robot.limits.upper == planar.limits.upper).all()


@pytest.mark.parametrize("noisy", [False, True])
@pytest.mark.parametrize("informed", [True, False])
def test_the_estimate_pauses_during_a_push_and_continues_afterwards(
    informed: bool, noisy: bool, planar: ffsms.SpaceManipulator
) -> None:
    """The push changes the momentum slowly between the two parts of the motion."""
    plant = perturb(planar, arm_mass=[1.2, 0.9, 1.1])
    rng = np.random.default_rng(3)
    accelerations = 0.4 * np.sin(np.linspace(0.0, 12.0, 400)[:, None] * rng.uniform(0.5, 2.0, 3))
    q, rates = roll_out(plant, plant.configuration(np.ones(3)), np.zeros(3), accelerations, 0.02, np.zeros(6))
    estimate = ScaleFactors(planar)
    estimate.noisy = noisy
    errors = []
    for k, (a, u) in enumerate(zip(q, rates, strict=True)):
        pushing = np.clip((k - 150) / 100, 0.0, 1.0) * np.array([0.3, -0.2, 0.0, 0.0, 0.0, 0.1])
        if informed and 150 < k <= 250:
            estimate.pushed()
        assert not estimate.update(0.0, a, plant.velocity(a, u, pushing))
        errors.append(np.abs(estimate.solve() - [1.2, 0.9, 1.1, 1.0]).max())
    if informed:
        assert max(errors[k] for k in range(150, 251)) < 1.05 * errors[149]
        assert errors[-1] < 0.7 * errors[149]
    else:
        assert errors[-1] > 3.0 * errors[149]


def test_a_robot_at_rest_leaves_the_factors(planar: ffsms.SpaceManipulator) -> None:
    still = ScaleFactors(planar)
    assert not still.update(0.0, planar.configuration(np.ones(3)), np.zeros(9))
    still.robot()
    np.testing.assert_array_equal(still.factors, 1.0)


def test_factors_refer_to_the_observed_robot(planar: ffsms.SpaceManipulator) -> None:
    """The base and the arm of the controller's estimate are exact, so no factor changes."""
    plant = perturb(planar, arm_mass=[1.2, 0.9, 1.1], base_mass=0.9, base_inertia=1.3)
    accelerations = 0.4 * np.sin(np.linspace(0.0, 12.0, 200)[:, None] * np.array([0.7, 1.1, 1.6]))
    q, rates = roll_out(plant, plant.configuration(np.ones(3)), np.zeros(3), accelerations, 0.02, np.zeros(6))
    estimate, fresh = ScaleFactors(planar), ScaleFactors(plant)
    estimate.observe_robot(plant)
    for a, u in zip(q, rates, strict=True):
        for factors in (estimate, fresh):
            factors.update(0.0, a, plant.velocity(a, u))
    np.testing.assert_allclose(estimate.solve(), 1.0, atol=1e-6)
    np.testing.assert_array_equal(estimate.shown[0], fresh.shown[0])


def test_a_captured_body_is_detected(planar: ffsms.SpaceManipulator) -> None:
    q = planar.configuration(np.ones(3))
    estimate, rates = ScaleFactors(planar), np.array([0.2, -0.1, 0.3])
    assert not estimate.update(0.0, q, planar.velocity(q, rates))
    assert not estimate.update(0.0, q, planar.velocity(q, rates))
    assert estimate.update(0.0, q, planar.velocity(q, rates, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 3.0])))


def test_noisy_estimates_stay_within_their_bounds(planar: ffsms.SpaceManipulator) -> None:
    """With exact sensors, factors beyond the bounds are discarded; with noise they are fitted within them."""
    plant = perturb(planar, arm_mass=[3.0, 0.9, 1.1])
    accelerations = 0.4 * np.sin(np.linspace(0.0, 12.0, 400)[:, None] * np.array([0.7, 1.1, 1.6]))
    q, rates = roll_out(plant, plant.configuration(np.ones(3)), np.zeros(3), accelerations, 0.02, np.zeros(6))
    estimate = ScaleFactors(planar)
    for a, u in zip(q, rates, strict=True):
        estimate.update(0.0, a, plant.velocity(a, u))
    np.testing.assert_array_equal(estimate.solve(), 1.0)
    estimate.noisy = True
    factors = estimate.solve()
    assert factors.max() == pytest.approx(2.0)
    assert factors.min() >= 0.5

    # Any other factors within the bounds have a larger residual.
    def residual(at: np.ndarray) -> float:
        base, *arm = list(planar.model.inertias)[1:]
        bodies = [pin.Inertia(base.mass, base.lever, at[-1] * base.inertia)]
        for factor, body in zip(at[:-1], arm, strict=True):
            bodies.append(pin.Inertia(factor * body.mass, body.lever, factor * body.inertia))
        model, total = planar.with_inertias(bodies).model, []
        data = model.createData()
        for a, u in zip(q, rates, strict=True):
            about_com = pin.computeCentroidalMomentum(model, data, a, plant.velocity(a, u))
            total.append(pin.SE3(np.eye(3), data.com[0]).act(about_com).vector)
        scaled = (np.array(total) - np.mean(total, axis=0)) * estimate._scale
        return float((scaled**2).sum() + (((at - 1.0) / 0.2) ** 2).sum())

    least = residual(factors)
    for change in 0.02 * np.vstack([np.eye(4), -np.eye(4)]):
        assert residual(np.clip(factors + change, 0.5, 2.0)) >= least * (1.0 - 1e-6)


@pytest.mark.slow
@pytest.mark.long
def test_replanning_uses_the_momentum_after_a_push(planar: ffsms.SpaceManipulator) -> None:
    """A wrench pushes the base for 5 s; planning with the old momentum misses by more than 0.1 m."""
    q0, final_errors = planar.configuration(np.radians([10.0, 30.0, 30.0])), []
    for informed in (False, True):
        problem = opt.Problem(planar, q0, [0.5, 0.6, 0.0], 12.0, 0.1)
        reference = opt.Replanning(problem, options=opt.ReplanOptions(period=1.0))
        reference.pushed = informed
        push = Wrench([0.2, 0.0, 0.0, 0.0, 0.0, 0.06], start=4.0, end=9.0)
        law = ComputedTorque(planar, K_p=25.0, K_d=10.0)
        tracking = ffsms.simulate(
            planar, reference, law, dt=0.01, q0=q0, conditions=ffsms.Conditions(disturbances=push)
        )
        final_errors.append(tracking.position_error[-1])
    assert final_errors[1] < 1e-3
    assert final_errors[0] > 0.1
