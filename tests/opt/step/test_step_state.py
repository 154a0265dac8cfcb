"""`StepState` agrees with the state of the robot."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from motions import random_pose

import ffsms_pin as ffsms
from ffsms_pin.opt.step.state import StepState


@pytest.mark.parametrize("name", ["planar_3r", "satellite_panda"])
def test_step_states_agree_with_robot_states(name: str) -> None:
    sms, rng = ffsms.load(name), np.random.default_rng(1)
    for _ in range(5):
        joints = 0.5 * rng.uniform(sms.limits.lower, sms.limits.upper)
        q, rates = sms.configuration(joints, random_pose(rng)), rng.uniform(-0.3, 0.3, sms.n)
        step, state = StepState(sms, q, rates, 0.01, 5.0), sms.at(q)
        np.testing.assert_allclose(step.J_star, state.J_star, atol=1e-12)
        np.testing.assert_allclose(step.J_arm, state.J_m, atol=1e-12)
        np.testing.assert_allclose(step.pose.homogeneous, state.end_effector_pose.homogeneous, atol=1e-12)
        M = pin.crba(sms.model, sms.model.createData(), q)
        np.testing.assert_allclose(step.reaction, -np.linalg.solve(M[:6, :6], M[:6, 6:]), atol=1e-12)
        np.testing.assert_allclose(sms.velocity(q, rates)[:6], step.reaction @ rates, atol=1e-12)
        assert step.entropy == pytest.approx(state.coupling.entropy, abs=1e-12)
        # Columns of V agree up to sign; columns without coupling are not unique.
        rank = min(6, sms.n) if sms.n > 3 else 2
        product = np.abs(step.V.T @ state.coupling.V)[:rank, :rank]
        np.testing.assert_allclose(product, np.eye(rank), atol=1e-6)
        np.testing.assert_allclose(step.joints, joints, atol=1e-12)
        np.testing.assert_array_equal(step.base_start, q[:7])
        np.testing.assert_array_equal(np.concatenate([step.drift, step.tip_drift]), np.zeros(12))


@pytest.mark.parametrize("name", ["planar_3r", "satellite_xarm7"])
def test_drift_agrees_with_the_state(name: str) -> None:
    sms, rng = ffsms.load(name), np.random.default_rng(2)
    momentum = rng.normal(size=6)
    if name == "planar_3r":
        momentum[[2, 3, 4]] = 0.0
    base = random_pose(rng) if sms.n > 3 else None
    q = sms.configuration(rng.uniform(-0.5, 0.5, sms.n), base)
    step = StepState(sms, q, np.zeros(sms.n), 0.01, 5.0, momentum)
    v = sms.velocity(q, np.zeros(sms.n), momentum)
    np.testing.assert_allclose(step.drift, v[:6], rtol=1e-10, atol=1e-14)
    np.testing.assert_allclose(step.tip_drift, sms.at(q, v).end_effector_twist, atol=1e-13)
    still = StepState(sms, q, np.zeros(sms.n), 0.01, 5.0)
    np.testing.assert_allclose(step.reaction, still.reaction, atol=1e-13)


def test_a_step_state_is_unchanged_by_the_next_state(planar: ffsms.SpaceManipulator) -> None:
    """Values are no views of shared buffers."""
    rates = np.zeros(3)
    first = StepState(planar, planar.configuration([0.1, 0.2, 0.3]), rates, 0.01, 5.0)
    kept = [np.array(x) for x in (first.reaction, first.J_star, first.J_arm, first.V)]
    position = first.pose.translation.copy()
    StepState(planar, planar.configuration([0.9, -0.7, 1.3]), rates, 0.01, 5.0)
    for before, now in zip(kept, (first.reaction, first.J_star, first.J_arm, first.V), strict=True):
        np.testing.assert_array_equal(before, now)
    np.testing.assert_array_equal(first.pose.translation, position)
    assert pin.sharedMemory()
