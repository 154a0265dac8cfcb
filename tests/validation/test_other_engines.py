"""MuJoCo and adam agree with us on six robots: matrices at random states, and ten seconds of motion."""

from __future__ import annotations

import mujoco as mj
import numpy as np
import pinocchio as pin
import pytest
from engines import ROBOTS, Adam, Mujoco, apart, ours, random_state, robot

from ffsms_pin.simulation.integrators import rk4_step
from ffsms_pin.urdf import model_path

STATES = 5
WITHIN = 1e-11  # relative to the largest entry


@pytest.mark.parametrize("name", ROBOTS)
def test_mujoco_has_the_same_matrices(name: str) -> None:
    sms = robot(name)
    peer, rng = Mujoco(sms), np.random.default_rng(5)
    for _ in range(STATES):
        q, v = random_state(sms, rng)
        differences = apart(ours(sms, q, v), peer.found(q, v))
        assert max(differences.values()) < WITHIN, differences


@pytest.mark.parametrize("name", ["planar_3r", "space_arm_7", "two_arms"])
def test_adam_has_the_same_matrices(name: str) -> None:
    sms = robot(name)
    peer, rng = Adam(sms, str(model_path(name))), np.random.default_rng(6)
    for _ in range(STATES):
        q, v = random_state(sms, rng)
        differences = apart(ours(sms, q, v), peer.found(q, v))
        assert max(differences.values()) < WITHIN, differences


def test_a_wrong_reference_point_would_be_seen() -> None:
    """The comparison can fail: with the root's origin as reference point, matrices differ."""
    sms = robot("space_arm_7")
    q, v = random_state(sms, np.random.default_rng(7))
    right = ours(sms, q, v)
    shifted = right.C_bm.copy()
    shifted[:3] += pin.skew(np.array([0.0, 0.1, 0.0])) @ shifted[3:]
    assert apart(right, right._replace(C_bm=shifted))["C_bm"] > 1e-3


@pytest.mark.parametrize("name", ROBOTS)
def test_ten_seconds_of_motion_under_the_same_torques(name: str) -> None:
    """Both integrate with Runge-Kutta of order 4, so the rates agree to its error at half a millisecond."""
    sms, dt, rng = robot(name), 5e-4, np.random.default_rng(8)
    q = sms.configuration(rng.uniform(-0.3, 0.3, sms.n))
    v = sms.velocity(q, np.zeros(sms.n))
    scale = 0.02 * np.diag(sms.at(q).H_q)  # some hundredths of a radian a second squared
    phase = rng.uniform(0.0, 6.0, sms.n)
    peer = Mujoco(sms, dt)
    peer.set(q, v)
    data, force = sms.model.createData(), np.zeros(sms.nv)
    for k in range(round(10.0 / dt)):
        force[6:] = scale * np.sin(k * dt + phase)
        peer.data.ctrl[:] = force[6:]
        mj.mj_step(peer.model, peer.data)
        q, v, _ = rk4_step(sms.model, data, q, v, force, dt)
    q_peer, v_peer = peer.state()
    assert np.abs(v[6:]).max() > 1e-3  # it moved
    np.testing.assert_allclose(v_peer[6:], v[6:], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(v_peer[3:6], v[3:6], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(q_peer[7:], q[7:], rtol=0.0, atol=1e-8)
