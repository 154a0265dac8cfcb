"""Compare bias accelerations with finite differences along the configuration manifold."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

import ffsms_pin as ffsms

Array = NDArray[np.float64]
NAMES = ("C_bm_dot_qd", "J_star_dot_qd", "base_bias_acceleration", "end_effector_bias_acceleration")
MOMENTUM = np.array([3.0, -2.0, 4.0, 1.5, -2.5, 2.0])


def rate_along(sms: ffsms.SpaceManipulator, q: Array, v: Array, value: Callable[[Array], Array]) -> Array:
    """Return the rate of a function of q along v by central differences, extrapolated to order 6."""

    def central(h: float) -> Array:
        ahead, behind = pin.integrate(sms.model, q, h * v), pin.integrate(sms.model, q, -h * v)
        return np.asarray((value(ahead) - value(behind)) / (2.0 * h))

    h = 4e-3
    d1, d2, d4 = central(h), central(2.0 * h), central(4.0 * h)
    return (64.0 * d1 - 20.0 * d2 + d4) / 45.0


def differences(sms: ffsms.SpaceManipulator, q: Array, v: Array) -> dict[str, Array]:
    """Return the four quantities by differences of twists and Jacobians."""
    rates, momentum = v[6:], sms.at(q, v).momentum

    def twist(name: str) -> Callable[[Array], Array]:
        # Each twist is a function of q only, because rates and momentum are constant.
        return lambda q: getattr(sms.at(q, sms.velocity(q, rates, momentum)), name)

    return {
        "C_bm_dot_qd": rate_along(sms, q, v, lambda q: sms.at(q).C_bm @ rates),
        "J_star_dot_qd": rate_along(sms, q, v, lambda q: sms.at(q).J_star @ rates),
        "base_bias_acceleration": rate_along(sms, q, v, twist("base_twist")),
        "end_effector_bias_acceleration": rate_along(sms, q, v, twist("end_effector_twist")),
    }


def check(sms: ffsms.SpaceManipulator, q: Array, v: Array) -> None:
    state = sms.at(q, v)
    for name, expected in differences(sms, q, v).items():
        computed = getattr(state, name)
        assert computed.shape == (6,)
        assert not computed.flags.writeable
        for rows in (slice(0, 3), slice(3, 6)):
            size = max(np.abs(expected[rows]).max(), 1e-3)
            np.testing.assert_allclose(
                computed[rows], expected[rows], rtol=0.0, atol=1e-8 * size, err_msg=name
            )


def random_motion(sms: ffsms.SpaceManipulator, seed: int, momentum: Array | None) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    base = pin.SE3(pin.rpy.rpyToMatrix(rng.uniform(-1, 1, size=3)), rng.uniform(-1, 1, size=3))
    q = sms.configuration(rng.uniform(-1.0, 1.0, size=sms.n), base)
    return q, sms.velocity(q, rng.uniform(-0.5, 0.5, size=sms.n), momentum)


@pytest.mark.parametrize("momentum", [None, MOMENTUM], ids=["at zero momentum", "with momentum"])
@pytest.mark.parametrize("name", ["planar_3r", "space_arm_7", "satellite_panda"])
def test_robots(name: str, momentum: Array | None) -> None:
    sms = ffsms.load(name)
    for seed in range(3):
        check(sms, *random_motion(sms, seed, momentum))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("momentum", [None, 0.1 * MOMENTUM], ids=["at zero momentum", "with momentum"])
def test_trees(random_tree: Callable[..., Any], seed: int, momentum: Array | None) -> None:
    # The trees have branches, prismatic and continuous joints, and a base with an offset centre of mass.
    tree = random_tree(seed, 5, ("revolute", "continuous", "prismatic"))
    sms = ffsms.SpaceManipulator(tree.model(), "tip")
    check(sms, *random_motion(sms, seed, momentum))


@pytest.mark.parametrize("name", ["planar_3r", "satellite_panda"])
def test_without_momentum_the_products_are_the_accelerations(name: str) -> None:
    sms = ffsms.load(name)
    state = sms.at(*random_motion(sms, 1, None))
    np.testing.assert_allclose(state.C_bm_dot_qd, state.base_bias_acceleration, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(
        state.J_star_dot_qd, state.end_effector_bias_acceleration, rtol=0.0, atol=1e-15
    )
    # With momentum they differ, in the linear and in the angular part.
    state = sms.at(*random_motion(sms, 1, MOMENTUM))
    assert np.abs(state.C_bm_dot_qd - state.base_bias_acceleration)[:3].max() > 1e-4
    assert np.abs(state.J_star_dot_qd - state.end_effector_bias_acceleration)[3:].max() > 1e-4


def test_accelerations_of_a_driven_arm(random_tree: Callable[..., Any]) -> None:
    # The accelerations of base and end effector under joint torques follow from C_bm, J* and the bias.
    sms = ffsms.SpaceManipulator(random_tree(9, 6).model(), "tip")
    q, v = random_motion(sms, 9, MOMENTUM)
    state, data = sms.at(q, v), sms.model.createData()
    tau = np.concatenate([np.zeros(6), np.linspace(-2.0, 3.0, 6)])
    a = pin.aba(sms.model, data, q, v, tau).copy()

    def after(h: float) -> Array:
        # The first-order change of q and v suffices; the error of the extrapolation is of order h^6.
        moved = sms.at(pin.integrate(sms.model, q, h * v), v + h * a)
        return np.concatenate([moved.base_twist, moved.end_effector_twist])

    d1, d2, d4 = ((after(h) - after(-h)) / (2.0 * h) for h in (2e-3, 4e-3, 8e-3))
    expected = (64.0 * d1 - 20.0 * d2 + d4) / 45.0
    computed = np.concatenate(
        [
            state.C_bm @ a[6:] + state.base_bias_acceleration,
            state.J_star @ a[6:] + state.end_effector_bias_acceleration,
        ]
    )
    np.testing.assert_allclose(computed, expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())


def test_bias_accelerations_at_rest_are_zero(planar: ffsms.SpaceManipulator) -> None:
    state = planar.at(planar.configuration([0.3, -0.5, 1.0]))
    for name in NAMES:
        np.testing.assert_array_equal(getattr(state, name), 0.0, err_msg=name)


def test_another_state_in_between_changes_nothing(planar: ffsms.SpaceManipulator) -> None:
    q, v = random_motion(planar, 3, MOMENTUM)
    expected = {name: np.array(getattr(planar.at(q, v), name)) for name in NAMES}
    state = planar.at(q, v)
    for k, name in enumerate(NAMES):
        other = planar.at(*random_motion(planar, 10 + k, None))
        assert np.isfinite(other.J_star_dot_qd).all()
        np.testing.assert_array_equal(getattr(state, name), expected[name], err_msg=name)
