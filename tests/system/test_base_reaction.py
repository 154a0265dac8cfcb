"""Compare the base reaction -M_b^-1 M_bm and the base drift with the paper and with finite differences."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from paper_sums import assert_near, paper, pinocchio_state, random_case, skew

import ffsms_pin as ffsms
from ffsms_pin.errors import InvalidValue
from ffsms_pin.robot.base_motion import roll_out
from ffsms_pin.system import dynamics

Array = NDArray[np.float64]
KINDS = ("revolute", "prismatic", "continuous")


@pytest.fixture(params=range(5))
def setting(random_tree: Callable[..., Any], request: pytest.FixtureRequest) -> tuple[Any, ...]:
    """Return a random tree, its robot, a state in the paper's terms, and Pinocchio's q and v."""
    seed = int(request.param)
    tree = random_tree(seed, seed + 2, KINDS)
    sms = ffsms.SpaceManipulator(tree.model(), "tip")
    case = random_case(tree, np.random.default_rng(seed))
    return tree, sms, case, *pinocchio_state(tree, sms, case)


def test_the_reaction_is_the_papers(setting: tuple[Any, ...]) -> None:
    tree, sms, case, q, _ = setting
    M = dynamics.inertia_matrix(sms, q)
    reaction = dynamics.root_reaction(M)
    sums = paper(tree, case.root, case.joints, case.twist, case.rates)
    # Express the motion at the base's centre of mass in inertial axes.
    at_base = dynamics.base_to_root(q, sms.base_com).actionInverse @ reaction
    assert_near("C_bm", at_base, sums.C_bm)
    np.testing.assert_array_equal(dynamics.floating_motion(M), np.vstack([reaction, np.eye(sms.n)]))


def test_the_reaction_has_no_momentum(setting: tuple[Any, ...]) -> None:
    """The momentum follows from finite differences of the bodies' poses, without velocity formulas."""
    _, sms, case, q, _ = setting
    M, h = dynamics.inertia_matrix(sms, q), 1e-6
    v = dynamics.floating_motion(M) @ case.rates
    momentum = differences(sms, q, v, h)
    still = differences(sms, q, np.concatenate([np.zeros(6), case.rates]), h)
    assert np.abs(still).max() > 1e-2  # with a fixed base the momentum is not zero
    np.testing.assert_allclose(momentum, 0.0, atol=1e-6 * np.abs(still).max())


def test_modes_have_no_twist_in_held_and_no_momentum_in_free_directions(setting: tuple[Any, ...]) -> None:
    """Held directions have no twist; by finite differences of poses, free directions have no momentum."""
    _, sms, case, q, _ = setting
    state, h = sms.at(q), 1e-6
    assert_near("floating", dynamics.mode_coupling(state.H_b, state.H_bm, "floating"), state.C_bm, 1e-10)
    size = np.abs(differences(sms, q, np.concatenate([np.zeros(6), case.rates]), h)).max()
    held = {
        "rotation-floating": "spin",
        "rotation-flying": "spin",
        "translation-flying": "place",
        "flying": "both",
    }
    to_root = dynamics.base_to_root(q, sms.base_com).action
    for mode, what in held.items():
        twist = dynamics.mode_coupling(state.H_b, state.H_bm, mode) @ case.rates
        momentum = differences(sms, q, np.concatenate([to_root @ twist, case.rates]), h)
        if what == "spin":
            assert not twist[3:].any()
            np.testing.assert_allclose(momentum[:3], 0.0, atol=1e-6 * size)
            assert np.abs(momentum[3:]).max() > 1e-3 * size
        elif what == "place":
            assert not twist[:3].any()
            about_base = momentum[3:] + np.cross(state.com - state.base_pose.translation, momentum[:3])
            np.testing.assert_allclose(about_base, 0.0, atol=1e-5 * size)
            assert np.abs(momentum[:3]).max() > 1e-3 * size
        else:
            assert not twist.any()
    with pytest.raises(InvalidValue, match="rotation-floating"):
        dynamics.mode_coupling(state.H_b, state.H_bm, "drifting")


def test_the_drift_has_the_momentum(setting: tuple[Any, ...]) -> None:
    _, sms, case, q, _ = setting
    M, expected = dynamics.inertia_matrix(sms, q), np.array([1.0, -2.0, 3.0, 0.5, -0.4, 0.3])
    v = dynamics.floating_motion(M) @ case.rates
    v[:6] += dynamics.root_drift(M, q, expected, sms.base_com)
    np.testing.assert_allclose(differences(sms, q, v, 1e-6), expected, atol=1e-5)


@pytest.mark.parametrize("mode", dynamics.MODES)
def test_the_velocity_of_a_mode_is_that_of_its_rollout(setting: tuple[Any, ...], mode: str) -> None:
    _, sms, case, q, _ = setting
    momentum, h = np.array([1.0, -2.0, 3.0, 0.5, -0.4, 0.3]), 1e-5
    v = sms.velocity(q, case.rates, momentum, mode)
    ends, _ = roll_out(sms, q, case.rates, np.zeros((1, sms.n)), h, momentum, mode)
    velocity = pin.difference(sms.model, q, ends[1]) / h
    np.testing.assert_allclose(velocity, v, atol=1e-4 * max(1.0, np.abs(v).max()))


def test_joint_torques_on_a_floating_base_give_the_same_joint_accelerations(setting: tuple[Any, ...]) -> None:
    _, sms, _, q, _ = setting
    M = dynamics.inertia_matrix(sms, q)
    force = np.random.default_rng(3).normal(size=sms.nv)
    torques = dynamics.joint_torques(M, force)
    assert_near("torques", torques, dynamics.floating_motion(M).T @ force)
    # These joint torques give the same joint accelerations as the generalised force.
    floating = np.linalg.solve(M, np.concatenate([np.zeros(6), torques]))
    whole = np.linalg.solve(M, force)
    assert_near("accelerations", floating[6:], whole[6:], 1e-10)


def test_the_composite_rigid_body_of_the_system(setting: tuple[Any, ...]) -> None:
    tree, sms, case, q, v = setting
    whole = dynamics.whole_body(dynamics.inertia_matrix(sms, q))
    assert whole.mass == pytest.approx(sum(body.mass for body in tree.bodies), rel=1e-13)
    com = pin.XYZQUATToSE3(q[:7]).act(whole.lever)
    assert_near("centre of mass", com, paper(tree, case.root, case.joints, case.twist, case.rates).com)
    turning = np.zeros(sms.nv)
    turning[3:6] = v[3:6]
    turning[:3] = -skew(v[3:6]) @ whole.lever  # about the centre of mass
    R = pin.XYZQUATToSE3(q[:7]).rotation
    assert_near("angular momentum", R @ whole.inertia @ v[3:6], sms.at(q, turning).momentum[3:], 1e-11)


def differences(sms: ffsms.SpaceManipulator, q: Array, v: Array, h: float) -> Array:
    """Return the momentum (6,) about the system's centre of mass by central differences of poses."""
    before, after = (places(sms, pin.integrate(sms.model, q, step * v)) for step in (-h, h))
    here = places(sms, q)
    masses = np.array([body.mass for body in list(sms.model.inertias)[1:]])
    com = masses @ np.array([place.translation for place in here]) / masses.sum()
    momentum = np.zeros(6)
    for body, a, b, place in zip(list(sms.model.inertias)[1:], before, after, here, strict=True):
        velocity = (b.translation - a.translation) / (2.0 * h)
        omega = pin.log3(b.rotation @ a.rotation.T) / (2.0 * h)
        spin = place.rotation @ body.inertia @ place.rotation.T @ omega
        momentum[:3] += body.mass * velocity
        momentum[3:] += spin + np.cross(place.translation - com, body.mass * velocity)
    return momentum


def places(sms: ffsms.SpaceManipulator, q: Array) -> list[Any]:
    """Return the pose of each body, with the origin at its centre of mass."""
    data = sms.model.createData()
    pin.forwardKinematics(sms.model, data, q)
    bodies = list(sms.model.inertias)[1:]
    return [data.oMi[j] * pin.SE3(np.eye(3), np.array(body.lever)) for j, body in enumerate(bodies, start=1)]
