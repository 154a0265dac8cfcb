"""Test that momentum and torques are regressors times inertial parameters for packaged robots."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin.system.regressors import momentum_regressors, torque_regressor

PACKAGED = ("planar_3r", "servicer", "space_arm_7", "two_arms")


def random_states(sms: ffsms.SpaceManipulator, rng: Any, count: int) -> tuple[Any, Any]:
    """Return random q (count, nq) and v (count, 6 + n) with a random base pose."""
    q = []
    for _ in range(count):
        base = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))
        q.append(sms.configuration(rng.uniform(-1.0, 1.0, sms.n), base))
    return np.array(q), rng.normal(size=(count, sms.nv))


@pytest.mark.parametrize("name", PACKAGED)
def test_regressor_times_parameters_is_the_momentum(name: str, rng: Any) -> None:
    sms = ffsms.load(name)
    for q, v in zip(*random_states(sms, rng, 20), strict=True):
        state = sms.at(q, v)
        assert state.momentum_regressor.shape == (6, 10 * (1 + sms.n))
        momentum = state.momentum_regressor @ sms.inertial_parameters
        scale = np.abs(state.momentum_regressor) @ np.abs(sms.inertial_parameters)
        assert (np.abs(momentum - state.momentum) <= 1e-12 * np.maximum(scale, 1.0)).all()


@pytest.mark.parametrize("kinds", [("revolute", "prismatic"), ("continuous", "prismatic")])
@pytest.mark.parametrize("seed", range(4))
def test_momentum_regressors_of_random_trees(
    random_tree: Callable[..., Any], seed: int, kinds: Any, rng: Any
) -> None:
    sms = ffsms.SpaceManipulator(random_tree(seed, 6, kinds).model(), "tip")
    q, v = random_states(sms, rng, 8)
    about = rng.normal(size=3)
    stack = momentum_regressors(sms, q, v, about)
    for row, q_k, v_k in zip(stack, q, v, strict=True):
        state = sms.at(q_k, v_k)
        np.testing.assert_allclose(
            state.momentum_regressor @ sms.inertial_parameters, state.momentum, atol=1e-11
        )
        shifted = state.momentum.copy()
        shifted[3:] += np.cross(state.com - about, shifted[:3])
        np.testing.assert_allclose(row @ sms.inertial_parameters, shifted, atol=1e-11)


def test_a_stack_of_some_bodies_has_their_columns(rng: Any) -> None:
    sms = ffsms.load("two_arms")
    q, v = random_states(sms, rng, 5)
    whole, some = (momentum_regressors(sms, q, v, np.zeros(3), bodies) for bodies in (None, [0, 4]))
    np.testing.assert_array_equal(some, np.concatenate([whole[:, :, :10], whole[:, :, 40:50]], axis=2))


@pytest.mark.parametrize("name", PACKAGED)
def test_base_rows_vanish_and_joint_rows_are_the_torques(name: str, rng: Any) -> None:
    sms = ffsms.load(name)
    for q, v in zip(*random_states(sms, rng, 5), strict=True):
        state, qdd = sms.at(q, v), rng.normal(size=sms.n)
        force = state.torque_regressor(qdd) @ sms.inertial_parameters
        scale = float(np.abs(state.torque_regressor(qdd)).max() * np.abs(sms.inertial_parameters).max())
        np.testing.assert_allclose(force[:6], 0.0, atol=1e-12 * scale)
        rotors = np.array(sms.model.armature)[6:] * qdd
        np.testing.assert_allclose(force[6:], state.H_q @ qdd + state.C_q - rotors, atol=1e-12 * scale)


def test_momentum_changes_by_the_force_of_the_regressor(planar: ffsms.SpaceManipulator, rng: Any) -> None:
    # The base rows of the force are the rate of the momentum, here by finite differences, in root axes.
    q, v = (row[0] for row in random_states(planar, rng, 1))
    acceleration, h = rng.normal(size=planar.nv), 1e-5
    force = torque_regressor(planar, q, v, acceleration) @ planar.inertial_parameters
    ends = [
        planar.at(pin.integrate(planar.model, q, s * h * v), v + s * h * acceleration) for s in (1.0, -1.0)
    ]
    rate = (ends[0].momentum - ends[1].momentum) / (2.0 * h)
    np.testing.assert_allclose(pin.XYZQUATToSE3(q[:7]).rotation @ force[:3], rate[:3], atol=1e-6)
