"""Torques of stacks of motions in every mode, against Pinocchio's dynamics."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin.opt.rollouts import force_slopes, forces
from ffsms_pin.system.batch.arm import ArmStack
from ffsms_pin.system.dynamics import MODES, mode_reaction

ROBOTS = ("planar_3r", "satellite_panda", "satellite_kinova", "space_arm_7")


def random_states(sms: ffsms.SpaceManipulator, rng: np.random.Generator, count: int) -> Any:
    """Return random joint positions, rates and accelerations (n, count)."""
    return [rng.uniform(-size, size, (sms.n, count)) for size in (1.0, 1.0, 2.0)]


@pytest.mark.parametrize("robot", ROBOTS)
def test_forward_dynamics_with_the_torques_give_the_accelerations(
    robot: str, rng: np.random.Generator
) -> None:
    """Apply ABA with these torques and no wrench on the base, which has momentum."""
    sms = ffsms.load(robot)
    model, data, stack = sms.model, sms.model.createData(), ArmStack(sms)
    joints, rates, accelerations = random_states(sms, rng, 4)
    arm, drift, start = stack.evaluate(joints), np.zeros((3, 4)), []
    for i in range(4):
        rotation = pin.exp3(rng.normal(size=3))
        q = sms.configuration(joints[:, i], pin.SE3(rotation, rng.normal(size=3)))
        momentum = rng.uniform(-1.0, 1.0, 6) * (i > 0)
        start.append((q, sms.velocity(q, rates[:, i], momentum)))
        drift[:, i] = arm.inverse[..., i] @ rotation.T @ momentum[3:]
    torques = forces(stack, joints, rates, accelerations, drift)[:-6]
    for i, (q, v) in enumerate(start):
        accelerations_by_aba = pin.aba(model, data, q, v, np.concatenate([np.zeros(6), torques[:, i]]))
        np.testing.assert_allclose(accelerations_by_aba[6:], accelerations[:, i], rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("mode", list(MODES))
@pytest.mark.parametrize("robot", ROBOTS)
def test_torques_agree_with_inverse_dynamics(robot: str, mode: str, rng: np.random.Generator) -> None:
    """The base acceleration is by differences; the wrench on the base has no effect on the joint torques."""
    sms = ffsms.load(robot)
    model, data, stack = sms.model, sms.model.createData(), ArmStack(sms, mode)
    joints, rates, accelerations = random_states(sms, rng, 3)
    torques = forces(stack, joints, rates, accelerations)[:-6]
    h = 1e-6
    for i in range(3):
        q = sms.configuration(joints[:, i])

        def velocity_of(q: Any, u: Any) -> Any:
            M = pin.crba(model, data, q)
            M = np.triu(M) + np.triu(M, 1).T
            return np.concatenate([mode_reaction(M, sms.base_com, mode) @ u, u])

        v = velocity_of(q, rates[:, i])
        # The base's acceleration by differences along the motion.
        ahead, behind = (pin.integrate(model, q, t * v) for t in (h, -h))
        dv = (
            velocity_of(ahead, rates[:, i] + h * accelerations[:, i])
            - velocity_of(behind, rates[:, i] - h * accelerations[:, i])
        ) / (2.0 * h)
        force = pin.rnea(model, data, q, v, dv)
        size = np.abs(force[6:]).max()
        np.testing.assert_allclose(torques[:, i], force[6:], rtol=0.0, atol=1e-7 * size)
        if mode == "floating":
            np.testing.assert_allclose(force[:6], 0.0, atol=1e-6 * size)


@pytest.mark.parametrize("robot", ROBOTS)
def test_torques_by_rates_and_by_accelerations_agree_with_the_state(
    robot: str, rng: np.random.Generator
) -> None:
    sms = ffsms.load(robot)
    stack = ArmStack(sms)
    joints, rates, accelerations = random_states(sms, rng, 1)
    q = sms.configuration(joints[:, 0])
    state = sms.at(q, sms.velocity(q, rates[:, 0]))
    still, drift = np.zeros_like(rates), np.zeros((3, 1))
    bias = forces(stack, joints, rates, still, drift)[:-6, 0]
    by_acceleration = forces(stack, joints, still, accelerations, drift)[:-6, 0]
    np.testing.assert_allclose(bias, state.C_q, rtol=0.0, atol=1e-10 * np.abs(state.C_q).max())
    inertial = state.H_q @ accelerations[:, 0]
    np.testing.assert_allclose(by_acceleration, inertial, rtol=0.0, atol=1e-10 * np.abs(inertial).max())


@pytest.mark.parametrize("mode", list(MODES))
@pytest.mark.parametrize("robot", ROBOTS[:2])
def test_derivatives_of_torques_agree_with_differences(
    robot: str, mode: str, rng: np.random.Generator
) -> None:
    sms = ffsms.load(robot)
    stack = ArmStack(sms, mode)
    values = random_states(sms, rng, 3)
    drift = 0.1 * rng.normal(size=(3, 3)) * (mode == "floating")

    def forces_at(joints: Any, rates: Any, accelerations: Any) -> Any:
        return forces(stack, joints, rates, accelerations, drift)

    slopes = force_slopes(stack, values[0], values[1], values[2], drift)
    for kind, slope in enumerate(slopes.values()):
        for k in range(sms.n):
            step = np.zeros((sms.n, 1))
            step[k] = 1e-5
            ahead, behind = (
                [x + sign * step * (i == kind) for i, x in enumerate(values)] for sign in (1, -1)
            )
            difference = (forces_at(*ahead) - forces_at(*behind)) / 2e-5
            np.testing.assert_allclose(slope[:, k], difference, rtol=0.0, atol=1e-6 * np.abs(slope).max())
