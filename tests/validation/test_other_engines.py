"""Compare matrices and motions of six robots with MuJoCo, adam and Basilisk."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from engine_motions import basilisk_end, mujoco_end, our_end, push, rate_difference
from engines import ROBOTS, Adam, Mujoco, ours, random_state, relative_differences, robot

from ffsms_pin.simulation import perturb
from ffsms_pin.urdf import model_path

STATES = 5
TOLERANCE = 1e-11  # relative to the largest entry


@pytest.mark.parametrize("name", ROBOTS)
def test_mujoco_has_the_same_matrices(name: str) -> None:
    sms = robot(name)
    peer, rng = Mujoco(sms), np.random.default_rng(5)
    for _ in range(STATES):
        q, v = random_state(sms, rng)
        differences = relative_differences(ours(sms, q, v), peer.matrices(q, v))
        assert max(differences.values()) < TOLERANCE, differences


@pytest.mark.parametrize("name", ["planar_3r", "space_arm_7", "two_arms"])
def test_adam_has_the_same_matrices(name: str) -> None:
    sms = robot(name)
    peer, rng = Adam(sms, str(model_path(name))), np.random.default_rng(6)
    for _ in range(STATES):
        q, v = random_state(sms, rng)
        differences = relative_differences(ours(sms, q, v), peer.matrices(q, v))
        assert max(differences.values()) < TOLERANCE, differences


def test_a_wrong_reference_point_is_detected() -> None:
    """The comparison detects a reference point of the base that is shifted by 0.1 m."""
    sms = robot("space_arm_7")
    q, v = random_state(sms, np.random.default_rng(7))
    right = ours(sms, q, v)
    shifted = right.C_bm.copy()
    shifted[:3] += pin.skew(np.array([0.0, 0.1, 0.0])) @ shifted[3:]
    assert relative_differences(right, right._replace(C_bm=shifted))["C_bm"] > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOTS)
def test_ten_seconds_of_motion_in_mujoco(name: str) -> None:
    """Both integrate with Runge-Kutta of order 4, so the rates agree to its error at half a millisecond."""
    sms = robot(name)
    motion = push(sms)
    (q, v), (q_peer, v_peer) = our_end(sms, motion, 5e-4), mujoco_end(sms, motion, 5e-4)
    assert np.abs(v[6:]).max() > 1e-3  # it moved
    np.testing.assert_allclose(v_peer[6:], v[6:], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(v_peer[3:6], v[3:6], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(q_peer[7:], q[7:], rtol=0.0, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOTS)
def test_ten_seconds_of_motion_in_basilisk(name: str) -> None:
    """Basilisk's spinning bodies are another formulation; joint rates agree to 1e-9 of their norm."""
    sms = robot(name)
    motion = push(sms)
    ours_at_end, theirs = our_end(sms, motion, 5e-3), basilisk_end(sms, motion, 5e-3)
    (q, v), (q_peer, v_peer) = ours_at_end, theirs
    assert np.abs(v[6:]).max() > 1e-3
    assert rate_difference(ours_at_end, theirs) < 1e-9
    np.testing.assert_allclose(v_peer[:6], v[:6], rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(q_peer, q, rtol=0.0, atol=1e-9)


def test_another_mass_is_detected_in_basilisk() -> None:
    """The comparison detects an arm that is heavier by a millionth; rates differ by far more than 1e-9."""
    sms = robot("planar_3r")
    motion = push(sms)
    heavier = basilisk_end(perturb(sms, arm_mass=1.0 + 1e-6), motion, 1e-2)
    assert rate_difference(our_end(sms, motion, 1e-2), heavier) > 1e-7
