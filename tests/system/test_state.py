"""Compare all quantities of a state with the paper's formulas, evaluated from masses and lengths."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st
from paper_sums import ARRAYS, assert_near, paper, pinocchio_state, random_case

import ffsms_pin as ffsms


def check_all(tree: Any, sms: ffsms.SpaceManipulator, case: Any) -> None:
    q, v = pinocchio_state(tree, sms, case)
    state = sms.at(q, v)
    expected = paper(tree, case.root, case.joints, case.twist, case.rates)
    for name in ARRAYS:
        if name != "C_be":
            assert_near(name, getattr(state, name), getattr(expected, name))
    assert_near("kinetic_energy", state.kinetic_energy, expected.kinetic_energy)
    assert_near("base position", state.base_pose.translation, expected.r_b)
    assert_near("base attitude", state.base_pose.rotation, expected.R_b)
    assert_near("end effector position", state.end_effector_pose.translation, expected.r_e)
    assert_near("end effector attitude", state.end_effector_pose.rotation, expected.R_e)
    assert_near("sigma", state.coupling.sigma, np.linalg.svd(expected.C_bm, compute_uv=False))


def test_planar_arm_is_the_papers_sums(planar: ffsms.SpaceManipulator, planar_tree: Any, rng: Any) -> None:
    for _ in range(40):
        check_all(planar_tree, planar, random_case(planar_tree, rng))


@settings(max_examples=80, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 9))
def test_random_trees_are_the_papers_sums(random_tree: Callable[..., Any], seed: int, n: int) -> None:
    tree = random_tree(seed, n)
    check_all(
        tree, ffsms.SpaceManipulator(tree.model(), "tip"), random_case(tree, np.random.default_rng(seed))
    )


@pytest.mark.parametrize("seed", range(5))
def test_continuous_joints_are_the_papers_sums(random_tree: Callable[..., Any], seed: int) -> None:
    tree = random_tree(seed, 5, ("revolute", "continuous", "continuous"))
    sms = ffsms.SpaceManipulator(tree.model(), "tip")
    assert sms.nq > sms.nv + 1
    check_all(tree, sms, random_case(tree, np.random.default_rng(seed)))


@pytest.mark.parametrize("seed", range(5))
def test_trees_from_a_file_are_the_papers_sums(
    random_tree: Callable[..., Any], tmp_path: Path, seed: int
) -> None:
    # The file has an offset inertial in the root link, a massless tool frame and continuous joints.
    tree = random_tree(seed, 6, ("revolute", "continuous", "prismatic"))
    path = tmp_path / "tree.urdf"
    path.write_text(tree.urdf())
    sms = ffsms.load(path, end_effector="tip")
    assert sms.joint_names == [f"joint_{i}" for i in range(1, 7)]  # the order of the tree
    check_all(tree, sms, random_case(tree, np.random.default_rng(seed)))


@pytest.mark.parametrize("seed", range(8))
def test_pinocchio_agrees(random_tree: Callable[..., Any], seed: int) -> None:
    tree = random_tree(seed, 6)
    sms = ffsms.SpaceManipulator(tree.model(), "tip")
    q, v = pinocchio_state(tree, sms, random_case(tree, np.random.default_rng(seed)))
    state = sms.at(q, v)
    data = sms.model.createData()
    # With joint torques C_q and no wrench on the base, the joint rates are constant.
    acceleration = pin.aba(sms.model, data, q, v, np.concatenate([np.zeros(6), state.C_q]))
    assert_near("joint accelerations", acceleration[6:], np.zeros(6), 1e-11)
    assert_near("C_q", state.C_q, pin.rnea(sms.model, data, q, v, acceleration)[6:])
    assert_near("momentum", state.momentum, pin.computeCentroidalMomentum(sms.model, data, q, v).vector)
    assert_near("kinetic energy", state.kinetic_energy, pin.computeKineticEnergy(sms.model, data, q, v))


@pytest.mark.parametrize("seed", range(6))
def test_velocity_has_the_given_momentum(random_tree: Callable[..., Any], seed: int) -> None:
    tree = random_tree(seed, 4)
    sms = ffsms.SpaceManipulator(tree.model(), "tip")
    case = random_case(tree, np.random.default_rng(seed))
    q, _ = pinocchio_state(tree, sms, case)
    for momentum in (None, np.zeros(6), np.array([1.0, -2.0, 3.0, 0.5, -0.4, 0.3])):
        v = sms.velocity(q, case.rates, momentum)
        np.testing.assert_array_equal(v[6:], case.rates)
        state = sms.at(q, v)
        sums = paper(tree, case.root, case.joints, np.array(state.base_twist), case.rates)
        assert_near("momentum", sums.momentum, np.zeros(6) if momentum is None else momentum)
        if momentum is None:
            assert_near("base twist", state.base_twist, sums.C_bm @ case.rates)


def test_generalised_jacobian_is_the_end_effectors_motion(random_tree: Callable[..., Any]) -> None:
    tree, h = random_tree(3, 7), 1e-5
    sms = ffsms.SpaceManipulator(tree.model(), "tip")
    case = random_case(tree, np.random.default_rng(3))
    q, _ = pinocchio_state(tree, sms, case)
    v = sms.velocity(q, case.rates)
    ends = []
    for step in (-h, h):
        moved = pin.integrate(sms.model, q, v * step)
        ends.append(paper(tree, moved[:7], moved[7:], np.zeros(6), np.zeros(7)))
    linear = (ends[1].r_e - ends[0].r_e) / (2.0 * h)
    W = (ends[1].R_e - ends[0].R_e) / (2.0 * h) @ sms.at(q).end_effector_pose.rotation.T
    measured = np.concatenate([linear, [W[2, 1], W[0, 2], W[1, 0]]])
    assert_near("end effector twist", sms.at(q).J_star @ case.rates, measured, 1e-8)


@pytest.mark.parametrize("n", [2, 6, 9])
def test_end_to_base_coupling(random_tree: Callable[..., Any], n: int) -> None:
    tree = random_tree(12, n, ("revolute",))
    sms = ffsms.SpaceManipulator(tree.model(), "tip")
    q, _ = pinocchio_state(tree, sms, random_case(tree, np.random.default_rng(5)))
    state = sms.at(q)
    J = np.array(state.J_star)
    assert_near("C_be J*J*+", state.C_be @ J @ np.linalg.pinv(J, rcond=1e-10), state.C_be, 1e-9)
    if np.linalg.matrix_rank(J, tol=1e-6) == n:
        # If the columns are independent, the end effector's twist determines joint rates and base twist.
        assert_near("C_be J*", state.C_be @ J, state.C_bm, 1e-9)


@pytest.mark.parametrize("n", [1, 3, 5, 6, 8])
def test_end_to_base_coupling_uses_the_pseudo_inverse(
    n: int, random_tree: Callable[..., Any], planar: ffsms.SpaceManipulator, rng: Any
) -> None:
    # Several states in a row, because buffers of a state must not affect the next state.
    sms = ffsms.SpaceManipulator(random_tree(n, n).model(), "tip")
    for _ in range(10):
        for robot in (planar, sms):
            state = robot.at(robot.configuration(rng.uniform(-1.0, 1.0, robot.n)))
            expected = state.C_bm @ np.linalg.pinv(state.J_star, rcond=1e-10)
            assert_near("C_be", state.C_be, expected, 1e-9)
            np.testing.assert_array_equal(robot.at(state.q).C_be, state.C_be)


def test_end_to_base_coupling_of_a_redundant_planar_arm(planar_tree: Any, rng: Any) -> None:
    # With five parallel axes J* has rank 3, so singular values of rounding size must not be inverted.
    bodies = [*planar_tree.bodies, *(planar_tree.bodies[3]._replace(parent=3 + i) for i in range(2))]
    tree = type(planar_tree)(bodies, planar_tree.tip_rotation, planar_tree.tip_position)
    sms = ffsms.SpaceManipulator(tree.model(), "tip")
    for _ in range(20):
        q, _ = pinocchio_state(tree, sms, random_case(tree, rng))
        state = sms.at(q)
        values = np.linalg.svd(state.J_star, compute_uv=False)
        assert values[3] < 1e-14 * values[0]
        assert np.abs(state.C_be).max() < 10.0 * state.coupling.sigma[0] / values[2]


def test_at_rest_there_are_no_velocity_forces(planar: ffsms.SpaceManipulator) -> None:
    state = planar.at(planar.configuration([0.3, -0.5, 1.0]))
    for name in ("C_b", "C_m", "C_q", "base_twist", "momentum"):
        np.testing.assert_array_equal(getattr(state, name), 0.0, err_msg=name)
    assert state.kinetic_energy == 0.0
