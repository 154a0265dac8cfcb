"""Rollouts of whole motions against rollouts by steps and against Pinocchio."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from motions import random_pose

import ffsms_pin as ffsms
from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.rollouts import Rollouts, configurations, rolled_out, velocities
from ffsms_pin.robot.base_motion import roll_out
from ffsms_pin.system.batch.arm import ArmStack

DT, STEPS = 0.02, 60
MOMENTUM = np.array([0.4, -0.3, 0.2, 0.3, -0.2, 0.5])


@pytest.fixture(scope="module", params=["planar_3r", "satellite_kinova", "tree"])
def sms(request: pytest.FixtureRequest, random_tree: Callable[..., Any]) -> ffsms.SpaceManipulator:
    """A planar arm, an arm with continuous joints, and a branched arm with prismatic joints."""
    if request.param == "tree":
        return ffsms.SpaceManipulator(random_tree(2, 5).model(), "tip")
    return ffsms.load(request.param)


def random_motion(
    sms: ffsms.SpaceManipulator, rng: np.random.Generator, momentum: FloatArray | None
) -> tuple[FloatArray, FloatArray, Rollouts]:
    """Return a start, joint rates at the nodes, and their motion."""
    base = random_pose(rng) if sms.n > 3 else None
    q0 = sms.configuration(rng.uniform(-0.5, 0.5, sms.n), base)
    t = np.linspace(0.0, 3.0, STEPS + 1)[:, None]
    rates = 0.3 * np.sin(rng.uniform(1.0, 3.0, sms.n) * t + rng.uniform(0.0, 6.0, sms.n))
    return q0, rates, rolled_out(sms, ArmStack(sms), q0, rates, DT, momentum)


@pytest.mark.parametrize("momentum", [None, MOMENTUM], ids=["at rest", "tumbling"])
def test_a_rollout_agrees_with_small_steps_and_pinocchio(
    sms: ffsms.SpaceManipulator, momentum: FloatArray | None, rng: np.random.Generator
) -> None:
    """Check momentum and differences of q by Pinocchio at the nodes."""
    q0, rates, motion = random_motion(sms, rng, momentum)
    q, v = configurations(sms, q0, motion), velocities(motion)
    np.testing.assert_array_equal(q[0], q0)
    np.testing.assert_array_equal(v[:, 6:], rates)
    fine = 4
    accelerations = np.repeat(np.diff(rates, axis=0) / DT, fine, axis=0)
    expected, _ = roll_out(sms, q0, rates[0], accelerations, DT / fine, momentum)
    for result, expected_row in zip(q, expected[::fine], strict=True):
        assert np.abs(pin.difference(sms.model, expected_row, result)).max() < 1e-8
    data, total = sms.model.createData(), np.zeros(6) if momentum is None else momentum
    for row, rate in zip(q, v, strict=True):
        centroidal = pin.computeCentroidalMomentum(sms.model, data, row, rate).vector
        np.testing.assert_allclose(centroidal, total, atol=1e-11)
    for k in range(1, STEPS, 7):
        ahead, behind = (pin.difference(sms.model, q[k], q[other]) for other in (k + 1, k - 1))
        np.testing.assert_allclose((ahead - behind) / (2.0 * DT), v[k], atol=2e-3)


@pytest.mark.parametrize("momentum", [None, MOMENTUM], ids=["at rest", "tumbling"])
def test_quantities_agree_with_states(
    sms: ffsms.SpaceManipulator, momentum: FloatArray | None, rng: np.random.Generator
) -> None:
    q0, _, motion = random_motion(sms, rng, momentum)
    q, v = configurations(sms, q0, motion), velocities(motion)
    for k in range(0, STEPS + 1, 10):
        state, i = sms.at(q[k], v[k]), 2 * k
        tip, base = state.end_effector_pose, state.base_pose
        twist, base_twist = state.end_effector_twist, state.base_twist
        np.testing.assert_allclose(motion.end_effector[:, 0, i], tip.translation, atol=1e-12)
        np.testing.assert_allclose(motion.attitude[:, :, 0, i], tip.rotation, atol=1e-12)
        np.testing.assert_allclose(motion.velocity[:, 0, i], twist[:3], atol=1e-12)
        np.testing.assert_allclose(motion.angular_velocity[:, 0, i], twist[3:], atol=1e-12)
        np.testing.assert_allclose(motion.base_position[:, 0, i], base.translation, atol=1e-12)
        np.testing.assert_allclose(motion.base_angular_velocity[:, 0, i], base_twist[3:], atol=1e-12)
        np.testing.assert_allclose(motion.com[:, i], state.com, atol=1e-11)
        assert motion.entropy[0, i] == pytest.approx(state.coupling.entropy, abs=1e-7)
    np.testing.assert_allclose(motion.base_start, sms.at(q0).base_pose.translation, atol=1e-13)


def test_midpoints_agree_with_a_rollout_in_half_steps(
    sms: ffsms.SpaceManipulator, rng: np.random.Generator
) -> None:
    q0, rates, motion = random_motion(sms, rng, None)
    fine = np.empty((2 * STEPS + 1, sms.n))
    fine[::2], fine[1::2] = rates, 0.5 * (rates[:-1] + rates[1:])
    nodes = rolled_out(sms, ArmStack(sms), q0, fine, 0.5 * DT)
    nodes_of_steps = slice(None, None, 2)
    np.testing.assert_allclose(motion.joints[:, 0], nodes.joints[:, 0, nodes_of_steps], atol=1e-13)
    np.testing.assert_allclose(motion.end_effector[:, 0], nodes.end_effector[:, 0, nodes_of_steps], atol=1e-7)
    np.testing.assert_allclose(motion.velocity[:, 0], nodes.velocity[:, 0, nodes_of_steps], atol=1e-7)


def test_weights_integrate_cubics_and_the_last_tenth_begins_at_0_9_T(
    sms: ffsms.SpaceManipulator, rng: np.random.Generator
) -> None:
    _, _, motion = random_motion(sms, rng, None)
    T = DT * STEPS
    assert motion.duration == pytest.approx(T)
    for power in range(4):  # Simpson's rule is exact up to cubics
        expected = T ** (power + 1) / (power + 1)
        assert motion.times**power @ motion.weights == pytest.approx(expected, rel=1e-12)
    np.testing.assert_allclose(motion.times[motion.last_tenth[0]], 0.9 * T)
    assert motion.last_tenth[-1] == motion.last
