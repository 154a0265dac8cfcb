"""The compiled kernel against Pinocchio and NumPy, and refused arguments."""

from __future__ import annotations

import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin.kernel import instructions, kernel
from ffsms_pin.opt.rollouts import coupling_slopes, entropy_and_gradient, velocity_slopes
from ffsms_pin.system.batch.arm import ArmStack
from ffsms_pin.system.dynamics import MODES, mode_coupling

ROBOTS = ["planar_3r", "satellite_panda", "two_arms", "one joint", "sliding", "32 joints"]
TREES = {"one joint": (3, 1, ("revolute",)), "sliding": (4, 5, ("prismatic",)), "32 joints": (5, 32, None)}


@pytest.fixture(scope="module", params=ROBOTS)
def robot(request: pytest.FixtureRequest, random_tree: Callable[..., Any]) -> ffsms.SpaceManipulator:
    """Packaged robots, also with two arms, and random trees whose base has an offset centre of mass."""
    if request.param in TREES:
        seed, n, kinds = TREES[request.param]
        tree = random_tree(seed, n) if kinds is None else random_tree(seed, n, kinds)
        return ffsms.SpaceManipulator(tree.model(), "tip")
    return ffsms.load(request.param, end_effector="left_tool" if request.param == "two_arms" else None)


@pytest.mark.parametrize("mode", MODES)
def test_quantities_of_the_arm_agree_with_pinocchio(
    robot: ffsms.SpaceManipulator, mode: str, rng: np.random.Generator
) -> None:
    joints = rng.uniform(-2.0, 2.0, (robot.n, 9))  # a full pack and a single configuration
    stack = ArmStack(robot, mode)
    arm = stack.evaluate(joints)
    model, data = robot.model, robot.model.createData()
    for k in (0, 5, 8):
        q = robot.configuration(joints[:, k])
        q[:7] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)  # the root at the origin, without rotation
        pin.computeAllTerms(model, data, q, np.zeros(model.nv))
        places = [data.oMi[j] for j in range(2, model.njoints)]
        scale = 1e-12 * max(1.0, float(np.abs(data.J).max()), float(np.abs(arm.points[..., k]).max()))
        for j, place in enumerate(places):
            np.testing.assert_allclose(arm.rotations[:, :, j, k], place.rotation, atol=1e-12)
            np.testing.assert_allclose(arm.points[:, j, k], place.translation, atol=scale)
        np.testing.assert_allclose(arm.velocities[..., k], data.J[:3, 6:], atol=scale)
        np.testing.assert_allclose(arm.axes[..., k], data.J[3:, 6:], atol=1e-12)
        momentum = data.M[:6, 6:]
        np.testing.assert_allclose(arm.linear[..., k], momentum[:3], atol=1e-12 * np.abs(momentum).max())
        np.testing.assert_allclose(arm.angular[..., k], momentum[3:], atol=1e-12 * np.abs(momentum).max())
        state = robot.at(q)
        coupling = mode_coupling(state.H_b, state.H_bm, mode)
        np.testing.assert_allclose(arm.coupling[..., k], coupling, atol=scale)
        np.testing.assert_allclose(arm.jstar[..., k], (state.J_b @ coupling + state.J_m)[:3], atol=scale)
        # The reference point is the total centre of mass, or the base's if the base is driven.
        still = state.com if stack.moves else stack.base_com
        np.testing.assert_allclose(arm.com[:, k], still, atol=scale)


def test_a_pack_has_the_bits_of_single_configurations(
    robot: ffsms.SpaceManipulator, rng: np.random.Generator
) -> None:
    joints = rng.uniform(-2.0, 2.0, (robot.n, 8))
    joints[:, 3] *= 1e7  # beyond the range of the kernel's own sine
    rates, direction = rng.normal(size=joints.shape), rng.normal(size=(6, *joints.shape))
    stack = ArmStack(robot)
    packed = stack.evaluate(joints)
    for k in range(8):
        index = [slice(k, k + 1)]
        single = stack.evaluate(joints[:, index[0]])
        for value, all_values in zip(single.arrays(), packed.arrays(), strict=True):
            np.testing.assert_array_equal(value, all_values[..., index[0]])
        pairs = [
            *zip(
                velocity_slopes(stack, single, rates[:, index[0]]),
                velocity_slopes(stack, packed, rates),
                strict=True,
            ),
            (
                coupling_slopes(stack, single, direction[..., index[0]]),
                coupling_slopes(stack, packed, direction),
            ),
            *zip(entropy_and_gradient(single.coupling), entropy_and_gradient(packed.coupling), strict=True),
        ]
        for value, all_values in pairs:
            np.testing.assert_array_equal(value, all_values[..., index[0]])


@pytest.mark.parametrize("largest", [0.8, 10.0, 1e3, 1e6, 1e9])
def test_sine_and_cosine_agree_with_numpy(largest: float, rng: np.random.Generator) -> None:
    angles = rng.uniform(-largest, largest, (3, 20000))
    rotations = ArmStack(ffsms.load("planar_3r")).evaluate(angles).rotations
    np.testing.assert_allclose(rotations[0, 0, 0], np.cos(angles[0]), rtol=0.0, atol=5e-16)
    np.testing.assert_allclose(rotations[1, 0, 0], np.sin(angles[0]), rtol=0.0, atol=5e-16)


def test_entropies_of_equal_and_zero_singular_values(rng: np.random.Generator) -> None:
    """The kernel works with squares, which lose digits below 1e-8 of the largest value."""
    U, _ = np.linalg.qr(rng.normal(size=(6, 6)))
    V, _ = np.linalg.qr(rng.normal(size=(7, 7)))
    for sigma in (
        [1.0] * 6,
        [2.0, 2.0, 1.0, 1.0, 0.5, 0.5],
        [1.0, 0.1, 1e-3, 1e-5, 1e-7, 1e-7],
        [1, 0, 0, 0, 0, 0],
    ):
        C = U @ np.diag(sigma) @ V[:6]
        share = np.asarray(sigma) / np.sum(sigma)
        logs = np.log(np.where(share > 0.0, share, 1.0))
        value, gradient = entropy_and_gradient(C[..., None])
        assert value[0] == pytest.approx(-float(share @ logs) / np.log(7), abs=2e-6)
        assert np.isfinite(gradient).all()


def test_a_pickled_tree_gives_the_same_values(
    robot: ffsms.SpaceManipulator, rng: np.random.Generator
) -> None:
    tree, joints = ArmStack(robot).tree, rng.uniform(-1.0, 1.0, (robot.n, 3))
    other = pickle.loads(pickle.dumps(tree))
    np.testing.assert_array_equal(kernel.coupled(tree, joints), kernel.coupled(other, joints))


_PLAN = """
import hashlib, sys
from numpy._core._multiarray_umath import __cpu_features__ as instructions
instructions["AVX2"] &= sys.argv[1] == "wide"
import ffsms_pin as ffsms
from ffsms_pin.kernel import kernel
sms = ffsms.load("satellite_panda")
plan = ffsms.opt.plan(sms, sms.home(), sms.at(sms.home()).end_effector_pose.translation + 0.2, 6.0)
print(kernel.__file__, hashlib.sha256(plan.q.tobytes()).hexdigest())
"""


def test_a_plan_has_the_same_bits_with_and_without_wide_instructions() -> None:
    runs = [
        subprocess.run([sys.executable, "-c", _PLAN, width], capture_output=True, text=True, check=True)
        for width in ("wide", "narrow")
    ]
    (wide, plan), (narrow, narrow_plan) = (run.stdout.split() for run in runs)
    assert plan == narrow_plan
    has_both = (Path(narrow).parent / "avx2").is_dir() and instructions.get("AVX2")
    assert (wide != narrow) == bool(has_both)


def test_wrong_shapes_are_refused() -> None:
    tree = ArmStack(ffsms.load("planar_3r")).tree
    with pytest.raises(ValueError, match="wrong shape"):
        kernel.coupled(tree, np.zeros((4, 2)))
    with pytest.raises(ValueError, match="wrong shape"):
        kernel.velocity_slopes(tree, np.zeros((3, 2)), np.zeros((3, 3)))
    with pytest.raises(TypeError, match="shape=\\(4, \\*\\)"):
        kernel.rate_bounds(np.zeros((3, 3)), np.zeros(3), np.zeros(3), 0.01)
    transposed = np.linspace(0.0, 1.0, 6).reshape(2, 3).T  # not contiguous
    np.testing.assert_array_equal(
        kernel.coupled(tree, transposed), kernel.coupled(tree, transposed.copy("C"))
    )
    row = np.eye(1, 17)
    with pytest.raises(ValueError, match="comes before"):
        kernel.Tree(row, np.ones((2, 13)), np.zeros((1, 12)), 0, True, True)
    with pytest.raises(ValueError, match="1 to 64 joints"):
        kernel.Tree(np.zeros((65, 17)), np.ones((66, 13)), np.zeros((1, 12)), 0, True, True)
