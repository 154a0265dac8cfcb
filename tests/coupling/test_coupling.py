"""The decomposition of C_bm, the normalised entropy and the assistance metric, and the limits of each."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray

import ffsms_pin as ffsms
from ffsms_pin.coupling import CouplingMetrics, entropy_of_values
from ffsms_pin.errors import InvalidValue

Array = NDArray[np.float64]
Builder = Callable[..., Any]


def random_state(tree: Any, seed: int) -> tuple[ffsms.SpaceManipulator, ffsms.State]:
    sms = ffsms.SpaceManipulator(tree.model(), "tip")
    return sms, sms.at(sms.configuration(np.random.default_rng(seed).uniform(-2.0, 2.0, size=sms.n)))


def entropy_by_definition(sigma: Array, n: int) -> float:
    """Return the paper's sum, with zeros for singular values beyond the rank."""
    padded = np.concatenate([sigma, np.zeros(n - len(sigma))])
    s = padded / padded.sum()
    return float(-sum(x * np.log(x) if x > 0.0 else 0.0 for x in s) / np.log(n))


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 9))
def test_decomposition(random_tree: Builder, seed: int, n: int) -> None:
    _, state = random_state(random_tree(seed, n), seed)
    c = state.coupling
    assert c.U.shape == (6, 6)
    assert c.sigma.shape == (min(6, n),)
    assert c.V.shape == (n, n)
    S = np.zeros((6, n))
    np.fill_diagonal(S, c.sigma)
    np.testing.assert_allclose(c.U @ S @ c.V.T, state.C_bm, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(c.U.T @ c.U, np.eye(6), rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(c.V.T @ c.V, np.eye(n), rtol=0.0, atol=1e-13)
    assert (np.diff(c.sigma) <= 0.0).all()
    assert (c.sigma >= 0.0).all()
    assert 0.0 <= c.entropy <= 1.0
    if n > 1:
        assert c.entropy == pytest.approx(entropy_by_definition(c.sigma, n), abs=1e-13)


@pytest.mark.parametrize("seed", range(3))
def test_the_entropy_of_a_single_joint_is_zero(random_tree: Builder, seed: int) -> None:
    _, state = random_state(random_tree(seed, 1), seed)
    assert state.coupling.entropy == 0.0
    assert state.coupling.sigma[0] > 0.0


def test_entropy_limits() -> None:
    for n in range(2, 7):
        assert entropy_of_values([0.3] * n, n) == pytest.approx(1.0, abs=1e-15)
        assert entropy_of_values([2.0] + [0.0] * (n - 1), n) == 0.0  # 0 log 0 = 0
        assert entropy_of_values([0.0] * n, n) == 0.0
    assert entropy_of_values([5.0], 1) == 0.0
    # With more joints than base coordinates, six equal values give an entropy below 1.
    assert entropy_of_values([1.0] * 6, 9) == pytest.approx(np.log(6) / np.log(9), abs=1e-15)
    # The shares are 3/4 and 1/4.
    assert entropy_of_values([3.0, 1.0], 2) == pytest.approx(0.8112781244591328, abs=1e-15)
    # The entropy does not depend on the scale.
    for scale in (1e-300, 1e-9, 1e9, 1e300):
        assert entropy_of_values([3.0 * scale, scale], 2) == pytest.approx(0.8112781244591328)


def test_metrics_without_coupling_are_zero() -> None:
    c = CouplingMetrics(np.zeros((6, 4)), lambda: np.zeros((3, 4)))
    assert c.entropy == 0.0
    np.testing.assert_array_equal(c.sigma, np.zeros(4))
    assert c.assistance(np.ones(4), [1.0, 0.0, 0.0]) == 0.0


@pytest.mark.parametrize(("seed", "n"), [(0, 3), (1, 6), (2, 8)])
def test_metrics_do_not_depend_on_the_base_pose(random_tree: Builder, seed: int, n: int) -> None:
    sms, state = random_state(random_tree(seed, n), seed)
    rng = np.random.default_rng(seed)
    turn = pin.rpy.rpyToMatrix(rng.uniform(-3.0, 3.0, size=3))
    transformed = np.array(state.q)
    base = pin.SE3(turn, rng.uniform(-2, 2, size=3)) * pin.XYZQUATToSE3(state.q[:7])
    transformed[:7] = pin.SE3ToXYZQUAT(base)
    other = sms.at(transformed)
    np.testing.assert_allclose(other.coupling.sigma, state.coupling.sigma, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(other.H_q, state.H_q, rtol=0.0, atol=1e-11)
    assert other.coupling.entropy == pytest.approx(state.coupling.entropy, abs=1e-13)
    # C_bm is in inertial axes and rotates with the system.
    R6 = np.kron(np.eye(2), turn)
    np.testing.assert_allclose(other.C_bm, R6 @ state.C_bm, rtol=0.0, atol=1e-12)
    # Directions in V agree up to sign, so their outer products agree.
    for i, (a, b) in enumerate(zip(state.coupling.V.T[:6], other.coupling.V.T[:6], strict=True)):
        gaps = np.abs(np.delete(state.coupling.sigma, i) - state.coupling.sigma[i])
        if gaps.min(initial=1.0) > 1e-3 * state.coupling.sigma[0]:
            np.testing.assert_allclose(np.outer(a, a), np.outer(b, b), rtol=0.0, atol=1e-9)


def test_singular_values_depend_on_the_reference_point(random_tree: Builder) -> None:
    # The twist of the root's origin has other singular values than that of the base's centre of mass.
    sms, state = random_state(random_tree(4, 5), 4)
    v = np.array([sms.velocity(state.q, unit) for unit in np.eye(5)]).T
    root = np.kron(np.eye(2), state.base_pose.rotation) @ v[:6]
    assert np.abs(np.linalg.svd(root, compute_uv=False) - state.coupling.sigma).max() > 1e-3
    # Transformed to the centre of mass, the twist is C_bm.
    lever = state.base_pose.rotation @ sms.base_com
    root[:3] += np.cross(root[3:].T, lever).T
    np.testing.assert_allclose(root, state.C_bm, rtol=0.0, atol=1e-13)


def test_assistance_limits(planar: ffsms.SpaceManipulator) -> None:
    state = planar.at(planar.configuration([0.3, -0.8, 1.1]))
    assist = state.coupling.assistance
    rates = np.array([0.2, -0.1, 0.3])
    velocity = state.J_star[:3] @ rates
    assert assist(rates, velocity) == pytest.approx(1.0, abs=1e-15)
    assert assist(rates, -velocity) == pytest.approx(-1.0, abs=1e-15)
    assert assist(rates, np.cross(velocity, [0.0, 0.0, 1.0])) == pytest.approx(0.0, abs=1e-15)
    assert assist(rates, [0.0, 0.0, 1.0]) == 0.0  # out of the plane
    rotated = np.array([[np.cos(1.0), -np.sin(1.0), 0], [np.sin(1.0), np.cos(1.0), 0], [0, 0, 1]]) @ velocity
    assert assist(rates, rotated) == pytest.approx(np.cos(1.0), abs=1e-14)
    # Without a motion or a direction the assistance is zero.
    assert assist(np.zeros(3), velocity) == 0.0
    assert assist(rates, np.zeros(3)) == 0.0
    assert assist(np.zeros(3), np.zeros(3)) == 0.0
    # Neither scale matters.
    for size in (1e-300, 1e-9, 1e9, 1e150):
        assert assist(rates * size, rotated) == pytest.approx(np.cos(1.0), abs=1e-12)
        assert assist(rates, rotated * size) == pytest.approx(np.cos(1.0), abs=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_assistance_is_the_cosine_with_the_direction(random_tree: Builder, seed: int) -> None:
    _, state = random_state(random_tree(seed, 7, ("revolute",)), seed)
    rng = np.random.default_rng(seed)
    for _ in range(50):
        rates, direction = rng.normal(size=7), rng.normal(size=3)
        assistance = state.coupling.assistance(rates, direction)
        end = state.J_star[:3] @ rates
        assert -1.0 <= assistance <= 1.0
        assert assistance == pytest.approx(
            end @ direction / np.linalg.norm(end) / np.linalg.norm(direction), abs=1e-13
        )
    # Null-space motion of the end effector has no direction beyond rounding.
    null = np.linalg.svd(state.J_star[:3])[2][3:]
    for rates in (*null, null.sum(axis=0)):
        assert state.coupling.assistance(rates, direction) == 0.0


@pytest.mark.parametrize(
    ("rates", "direction", "name"),
    [
        ([1.0, 2.0], [1, 0, 0], "joint_rates"),
        ([1.0, 2.0, np.nan], [1, 0, 0], "joint_rates"),
        ([1.0, 2.0, 3.0], [1, 0], "direction"),
    ],
)
def test_wrong_arguments_of_assistance_are_named(
    planar: ffsms.SpaceManipulator, rates: Any, direction: Any, name: str
) -> None:
    coupling = planar.at(planar.configuration([0.3, -0.8, 1.1])).coupling
    with pytest.raises(InvalidValue) as caught:
        coupling.assistance(rates, direction)
    assert caught.value.name == name
    assert "\n" not in str(caught.value)
