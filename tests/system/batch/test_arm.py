"""Compare stacks of the arm with `sms.at`, and derivatives with finite differences."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from slopes import tip_turning_slopes

import ffsms_pin as ffsms
from ffsms_pin.opt.rollouts import coupling_slopes, velocity_slopes
from ffsms_pin.system.batch.arm import ArmStack


@pytest.fixture(scope="module")
def trees(random_tree: Callable[..., Any]) -> list[ffsms.SpaceManipulator]:
    """Return branched robots with prismatic joints and a base whose centre of mass is off its origin."""
    return [ffsms.SpaceManipulator(random_tree(seed, n).model(), "tip") for seed, n in ((1, 4), (2, 7))]


def test_the_stack_agrees_with_the_state(
    trees: list[ffsms.SpaceManipulator], rng: np.random.Generator
) -> None:
    for sms in trees:
        joints = rng.uniform(-1.0, 1.0, (sms.n, 2, 3))
        stack = ArmStack(sms)
        arm = stack.evaluate(joints)
        turning = arm.spin + arm.axes * stack.moves_tip[:, None, None]
        for k in np.ndindex(2, 3):
            at = (..., *k)
            q = sms.configuration(joints[at])
            state = sms.at(q)  # base axes are inertial axes, because the base is not rotated
            np.testing.assert_allclose(arm.coupling[at], state.C_bm, atol=1e-12)
            np.testing.assert_allclose(arm.jstar[at], state.J_star[:3], atol=1e-12)
            np.testing.assert_allclose(turning[at], state.J_star[3:], atol=1e-12)
            np.testing.assert_allclose(
                arm.rho[at], state.end_effector_pose.translation - state.com, atol=1e-12
            )
            np.testing.assert_allclose(arm.tip_rotation[at], state.end_effector_pose.rotation, atol=1e-12)
            root = np.column_stack([sms.velocity(q, row)[:6] for row in np.eye(sms.n)])
            np.testing.assert_allclose(arm.root[at], root[:3], atol=1e-12)
            np.testing.assert_allclose(arm.spin[at], root[3:], atol=1e-12)
    assert ArmStack(trees[0]).mass == pytest.approx(trees[0].at(trees[0].configuration(np.zeros(4))).H[0, 0])


def test_slopes_of_velocities_and_coupling(
    trees: list[ffsms.SpaceManipulator], rng: np.random.Generator
) -> None:
    for sms in trees:
        stack, joints, h = ArmStack(sms), rng.uniform(-1.0, 1.0, (sms.n, 2)), 1e-5
        rates, weights = rng.normal(size=(sms.n, 2)), rng.normal(size=(6, sms.n, 2))
        arm = stack.evaluate(joints)
        spin, tip = velocity_slopes(stack, arm, rates)
        tip_spin = spin + tip_turning_slopes(stack, arm, rates)
        coupling = coupling_slopes(stack, arm, weights)
        for k in range(sms.n):
            step = h * np.eye(sms.n)[:, [k]]
            ahead, behind = stack.evaluate(joints + step), stack.evaluate(joints - step)
            moves = stack.moves_tip[:, None]
            for slope, values, factor in (
                (spin[:, k], [arm.spin for arm in (ahead, behind)], rates),
                (tip[:, k], [arm.jstar for arm in (ahead, behind)], rates),
                (tip_spin[:, k], [arm.spin + moves * arm.axes for arm in (ahead, behind)], rates),
                (coupling[None, k], [arm.coupling for arm in (ahead, behind)], weights),
            ):
                change = (values[0] - values[1]) / (2.0 * h)
                expected = (change * factor).sum(axis=1 if factor is rates else (0, 1))
                np.testing.assert_allclose(slope.squeeze(), expected, atol=2e-8)
