"""The first-order spread of a plan's end, compared with motions of sampled robots."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt import Trajectory
from ffsms_pin.opt.rollouts import rolled_out


def covariance_of(sms: ffsms.SpaceManipulator, share: float) -> Any:
    """Return the covariance of inertial parameters with a common relative error for each body."""
    blocks = [share**2 * np.outer(row, row) for row in sms.inertial_parameters.reshape(-1, 10)]
    covariance = np.zeros((10 * len(blocks),) * 2)
    for k, block in enumerate(blocks):
        covariance[10 * k : 10 * k + 10, 10 * k : 10 * k + 10] = block
    return covariance


def test_the_spread_agrees_with_sampled_robots(planar: ffsms.SpaceManipulator, plan: Trajectory) -> None:
    share, rng, ends = 0.02, np.random.default_rng(3), []
    for _ in range(400):
        bodies = [
            pin.Inertia(s * body.mass, body.lever, s * body.inertia)
            for body, s in zip(
                list(planar.model.inertias)[1:], 1.0 + share * rng.normal(size=1 + planar.n), strict=True
            )
        ]
        plant = planar.with_inertias(bodies)
        motion = rolled_out(plant, plant.arm_stack(), plan.q[0], plan.joint_rates, plan.dt)
        ends.append(motion.end_effector[:, 0, -1])
    sampled = np.cov(np.array(ends).T)
    spread = plan.spread(covariance_of(planar, share))
    assert np.sqrt(spread[0, 0]) > 1e-4  # [m]
    np.testing.assert_allclose(spread[:2, :2], sampled[:2, :2], atol=0.15 * np.abs(sampled).max())
    np.testing.assert_allclose(spread[2], 0.0, atol=1e-15)
    # The spread is of first order: half the deviations give a quarter of the covariance.
    np.testing.assert_allclose(plan.spread(covariance_of(planar, 0.5 * share)), 0.25 * spread, atol=1e-12)


def test_a_common_scale_of_all_masses_gives_no_spread(
    planar: ffsms.SpaceManipulator, plan: Trajectory
) -> None:
    parameters = planar.inertial_parameters
    spread = plan.spread(0.01 * np.outer(parameters, parameters))
    np.testing.assert_allclose(spread, 0.0, atol=1e-16)
    np.testing.assert_array_equal(plan.spread(np.zeros((40, 40))), np.zeros((3, 3)))


def test_the_spread_of_a_loaded_plan_requires_the_robot(
    planar: ffsms.SpaceManipulator, plan: Trajectory, tmp_path: Path, refused: Any
) -> None:
    plan.save(tmp_path / "plan.npz")
    loaded = Trajectory.load(tmp_path / "plan.npz")
    covariance = covariance_of(planar, 0.1)
    refused(lambda: loaded.spread(covariance), InvalidValue, "must be given")
    np.testing.assert_allclose(loaded.spread(covariance, planar), plan.spread(covariance), rtol=1e-9)
    refused(lambda: plan.spread(covariance[:30]), InvalidValue, "shape (40, 40)")
    refused(lambda: plan.spread(-covariance), InvalidValue, "below zero")
    refused(lambda: plan.spread(np.triu(np.ones((40, 40)))), InvalidValue, "symmetric")


def test_a_driven_attitude_has_no_spread_by_inertias(
    planar: ffsms.SpaceManipulator, plan: Trajectory
) -> None:
    """The motion of a base with a controlled attitude depends on masses alone."""
    inertia = np.zeros((40, 40))
    inertia[9, 9] = 0.01
    floating, driven = plan.spread(inertia), replace(plan, mode="rotation-floating").spread(inertia)
    assert np.trace(floating) > 1e-8
    assert np.trace(driven) == pytest.approx(0.0, abs=1e-18)
