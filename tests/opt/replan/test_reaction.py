"""The masses that a motion shows."""

from __future__ import annotations

import numpy as np
import pytest

import ffsms_pin as ffsms
from ffsms_pin.opt.replan.reaction import ReactionEstimate
from ffsms_pin.simulation import perturb
from ffsms_pin.system.base_motion import roll_out


@pytest.mark.parametrize("momentum", [np.zeros(6), np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.3])])
def test_reaction_is_estimated_from_the_motion(momentum: np.ndarray, planar: ffsms.SpaceManipulator) -> None:
    plant = perturb(planar, arm_mass=[1.2, 0.9, 1.1], base_mass=0.9, base_inertia=1.05)
    rng = np.random.default_rng(3)
    steps = 400
    accelerations = 0.4 * np.sin(np.linspace(0.0, 12.0, steps)[:, None] * rng.uniform(0.5, 2.0, 3))
    q, rates = roll_out(plant, plant.configuration(np.ones(3)), np.zeros(3), accelerations, 0.02, momentum)
    estimate = ReactionEstimate(planar)
    jumps = [estimate.observe(a, plant.velocity(a, u, momentum)) for a, u in zip(q, rates, strict=True)]
    assert not any(jumps)
    robot = estimate.robot()
    # Momentum has no scale: the base's mass is the unit.
    np.testing.assert_allclose(estimate.factors, np.array([1.2, 0.9, 1.1, 1.05]) / 0.9, atol=0.05)
    assert np.abs(planar.at(q[200]).C_bm - plant.at(q[200]).C_bm).max() > 9e-4
    np.testing.assert_allclose(robot.at(q[200]).C_bm, plant.at(q[200]).C_bm, atol=2e-4)
    assert (robot.limits.upper == planar.limits.upper).all()


def test_a_robot_at_rest_shows_nothing(planar: ffsms.SpaceManipulator) -> None:
    still = ReactionEstimate(planar)
    assert not still.observe(planar.configuration(np.ones(3)), np.zeros(9))
    still.robot()
    np.testing.assert_array_equal(still.factors, 1.0)


def test_a_captured_body_is_noticed(planar: ffsms.SpaceManipulator) -> None:
    q = planar.configuration(np.ones(3))
    estimate, rates = ReactionEstimate(planar), np.array([0.2, -0.1, 0.3])
    assert not estimate.observe(q, planar.velocity(q, rates))
    assert not estimate.observe(q, planar.velocity(q, rates))
    assert estimate.observe(q, planar.velocity(q, rates, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 3.0])))
