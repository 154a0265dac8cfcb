"""Compare the stacked arm in all base modes with `mode_coupling`, finite differences and Pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.rollouts import (
    coupling_slopes,
    entropy_and_gradient,
    force_slopes,
    forces,
    held_momentum,
    velocity_slopes,
)
from ffsms_pin.system.batch.arm import ArmStack, ArmValues
from ffsms_pin.system.dynamics import MODES, mode_coupling

H = 1e-6


@pytest.fixture(scope="module", params=["planar_3r", "satellite_panda"])
def sms(request: pytest.FixtureRequest) -> ffsms.SpaceManipulator:
    return ffsms.load(request.param)


@pytest.mark.parametrize("mode", MODES)
def test_coupling_and_jacobian_of_a_mode(
    sms: ffsms.SpaceManipulator, mode: str, rng: np.random.Generator
) -> None:
    joints = rng.uniform(-1.0, 1.0, (sms.n, 2))
    arm = ArmStack(sms, mode).evaluate(joints)
    for i in range(2):
        state = sms.at(sms.configuration(joints[:, i]))
        coupling = mode_coupling(state.H_b, state.H_bm, mode)
        R = state.base_pose.rotation
        np.testing.assert_allclose(R @ arm.coupling[:3, :, i], coupling[:3], atol=1e-13)
        np.testing.assert_allclose(R @ arm.coupling[3:, :, i], coupling[3:], atol=1e-13)
        J = state.J_b @ coupling + state.J_m
        np.testing.assert_allclose(R @ arm.jstar[..., i], J[:3], atol=1e-13)


@pytest.mark.parametrize("mode", MODES)
def test_slopes_of_a_mode(sms: ffsms.SpaceManipulator, mode: str, rng: np.random.Generator) -> None:
    stack, joints = ArmStack(sms, mode), rng.uniform(-1.0, 1.0, (sms.n, 2))
    rates, by = rng.normal(size=joints.shape), rng.normal(size=(6, sms.n, 2))
    arm = stack.evaluate(joints)
    spin, tip = velocity_slopes(stack, arm, rates)
    coupled = coupling_slopes(stack, arm, by)
    _, gradient = entropy_and_gradient(arm.coupling, stack.free_rows)
    mixed = coupling_slopes(stack, arm, gradient)

    def entropy(values: ArmValues) -> FloatArray:
        return entropy_and_gradient(values.coupling, stack.free_rows)[0]

    for k in range(sms.n):
        step = np.zeros_like(joints)
        step[k] = H
        ahead, behind = stack.evaluate(joints + step), stack.evaluate(joints - step)
        for of, slope in (("spin", spin), ("jstar", tip)):
            moved = np.einsum("xj...,j...->x...", getattr(ahead, of) - getattr(behind, of), rates) / (2.0 * H)
            np.testing.assert_allclose(slope[:, k], moved, atol=1e-7)
        change = ((ahead.coupling - behind.coupling) * by).sum(axis=(0, 1)) / (2.0 * H)
        np.testing.assert_allclose(coupled[k], change, atol=1e-7)
        np.testing.assert_allclose(mixed[k], (entropy(ahead) - entropy(behind)) / (2.0 * H), atol=1e-6)


def momentum_slopes(stack: ArmStack, arm: ArmValues, rates: FloatArray) -> FloatArray:
    """Return the derivatives (3, n) of the angular momentum at joint rates (n, 1) by joint positions."""
    return kernel.momentum_slopes(stack.tree, arm.positions, rates).reshape(3, -1)


def test_momentum_and_torque_of_a_held_base(sms: ffsms.SpaceManipulator, rng: np.random.Generator) -> None:
    """Compare with Pinocchio's centroidal dynamics of a base at rest."""
    joints, rates, accelerations = (rng.uniform(-1.0, 1.0, (sms.n, 1)) for _ in range(3))
    stack = ArmStack(sms, "rotation-floating")
    arm = stack.evaluate(joints)
    D, K = held_momentum(arm)[..., 0], momentum_slopes(stack, arm, rates)
    data, q = sms.model.createData(), sms.configuration(joints[:, 0])
    q[3:7] = (0.0, 0.0, 0.0, 1.0)
    v, a = (np.concatenate([np.zeros(6), x[:, 0]]) for x in (rates, accelerations))
    pin.computeCentroidalMomentumTimeVariation(sms.model, data, q, v, a)
    np.testing.assert_allclose(D @ rates[:, 0], data.hg.angular, atol=1e-12)
    torque = D @ accelerations[:, 0] + K @ rates[:, 0]
    np.testing.assert_allclose(torque, data.dhg.angular, atol=1e-12)
    np.testing.assert_allclose(forces(stack, joints, rates, accelerations)[-3:, 0], torque, atol=1e-12)
    # Compare the derivatives of the torque with finite differences.
    for kind, slope in enumerate(force_slopes(stack, joints, rates, accelerations).values()):
        for k in range(sms.n):
            sides = []
            for sign in (1.0, -1.0):
                moved = [joints.copy(), rates.copy(), accelerations.copy()]
                moved[kind][k] += sign * H
                there = stack.evaluate(moved[0])
                of = held_momentum(there)[..., 0] @ moved[2][:, 0]
                sides.append(of + momentum_slopes(stack, there, moved[1]) @ moved[1][:, 0])
            np.testing.assert_allclose(slope[-3:, k, 0], (sides[0] - sides[1]) / (2.0 * H), atol=1e-6)
