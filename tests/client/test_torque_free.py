"""A client's motion compared with an independent integration of Euler's equations; conserved quantities."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import ffsms_pin as ffsms
from ffsms_pin.checks import FloatArray

DEG = np.pi / 180.0
TIMES = np.linspace(0.0, 1000.0, 41)
POSE = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.7, 1.9), np.array([1.0, -2.0, 0.5]))
TILT = pin.rpy.rpyToMatrix(-0.4, 0.8, 0.6)


def integrated(inertia: FloatArray, attitude: FloatArray, spin: FloatArray) -> FloatArray:
    """Return attitudes (C, K, 3, 3) of C bodies at TIMES, integrated from Euler's equations by DOP853."""
    inverse = np.linalg.inv(inertia)

    def slope(t: float, y: FloatArray) -> FloatArray:
        state = y.reshape(-1, 7)
        w = state[:, :3]
        rate = np.einsum("cij,cj->ci", inverse, np.cross(np.einsum("cij,cj->ci", inertia, w), w))
        v, s = state[:, 3:6], state[:, 6:]
        turn = 0.5 * (s * w + np.cross(v, w))
        return np.hstack([rate, turn, -0.5 * np.sum(v * w, axis=1, keepdims=True)]).ravel()

    omega = np.einsum("cji,cj->ci", attitude, spin)
    start = np.hstack([omega, Rotation.from_matrix(attitude).as_quat()]).ravel()
    span = (0.0, TIMES[-1])
    done = solve_ivp(slope, span, start, "DOP853", TIMES, rtol=1e-13, atol=1e-16, max_step=1.0)
    quaternions = done.y.reshape(-1, 7, len(TIMES))[:, 3:].swapaxes(1, 2)
    matrices = Rotation.from_quat(quaternions.reshape(-1, 4)).as_matrix()
    return np.asarray(matrices.reshape(-1, len(TIMES), 3, 3))


SPINS = {
    "round the greatest": [0.4, 0.5, 2.0],
    "round the least": [2.0, 0.4, -0.7],
    "against the greatest": [0.3, -0.5, -2.0],
    "near the intermediate": [0.02, 1.0, -0.01],
    "against the intermediate": [5e-3, -1.0, 8e-3],
    "about the greatest": [0.0, 0.0, 1.0],
    "about the intermediate": [0.0, 1.0, 0.0],
    "about the least": [-1.0, 0.0, 0.0],
    "none": [0.0, 0.0, 0.0],
}
MOMENTS = {
    "tri-axial": [60.0, 85.0, 120.0],
    "other order": [120.0, 60.0, 85.0],
    "third order": [85.0, 120.0, 60.0],
    "oblate": [80.0, 80.0, 130.0],
    "prolate": [50.0, 110.0, 110.0],
    "nearly prolate": [50.0, 110.0, 110.0 + 1e-6],
    "nearly a sphere": [90.0, 90.0 + 1e-5, 90.0 + 1e-4],
    "sphere": [90.0, 90.0, 90.0],
    "rod": [20.0, 100.0, 100.4],
}


def test_attitudes_are_those_of_an_independent_integration() -> None:
    # Attitudes are turned only if rounding does not start a departure from the intermediate axis.
    names, bodies, attitudes, spins = [], [], [], []
    for body, moments in MOMENTS.items():
        for motion, direction in SPINS.items():
            R = np.eye(3) if motion.startswith("about") else POSE.rotation
            names.append(f"{body}, {motion}")
            bodies.append(np.diag(moments))
            attitudes.append(R)
            spins.append(5.0 * DEG / max(float(np.linalg.norm(direction)), 1.0) * R @ np.array(direction))
            if body == "tri-axial" and not motion.startswith("about"):  # axes that are not principal
                turned = TILT @ np.diag(moments) @ TILT.T
                names.append(f"tilted, {motion}")
                bodies.append(0.5 * (turned + turned.T))
                attitudes.append(R)
                spins.append(R @ TILT @ R.T @ spins[-1])
    expected = integrated(np.array(bodies), np.array(attitudes), np.array(spins))
    errors = {}
    for i, name in enumerate(names):
        pose = pin.SE3(attitudes[i], np.zeros(3))
        client = ffsms.Client(100.0, bodies[i], pose, [0.0, 0.0, 0.0, *spins[i]])
        errors[name] = float(np.abs(client.poses(TIMES)[1] - expected[i]).max())
    worst = max(errors, key=lambda name: errors[name])
    assert errors[worst] < 1e-10, f"{worst}: {errors[worst]:.1e}"


def test_momentum_energy_and_the_twist_as_the_rate_of_the_pose() -> None:
    inertia = TILT @ np.diag([60.0, 85.0, 120.0]) @ TILT.T
    client = ffsms.Client(80.0, 0.5 * (inertia + inertia.T), POSE, [0.01, 0.02, -0.03, 0.05, -0.02, 0.04])
    t = np.linspace(-300.0, 900.0, 25)
    positions, attitudes = client.poses(t)
    twists = client.twists(t)
    np.testing.assert_array_equal(positions, POSE.translation + np.outer(t, [0.01, 0.02, -0.03]))
    for R, twist in zip(attitudes, twists, strict=True):
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
        # The angular velocity comes from the momentum, so it is the energy that can fail.
        np.testing.assert_allclose(R @ client.inertia @ R.T @ twist[3:], client.momentum[3:], rtol=1e-12)
        energy = 0.5 * 80.0 * twist[:3] @ twist[:3] + 0.5 * twist[3:] @ client.momentum[3:]
        assert energy == pytest.approx(client.kinetic_energy, rel=1e-13)
    h = 1e-4
    ahead, behind = client.pose(100.0 + h), client.pose(100.0 - h)
    spin = pin.log3(ahead.rotation @ behind.rotation.T) / (2.0 * h)
    np.testing.assert_allclose(client.twist(100.0)[3:], spin, atol=1e-9)
    np.testing.assert_allclose(client.pose(0.0).homogeneous, POSE.homogeneous, atol=1e-15)


def test_a_motion_continues_from_its_state_at_any_time() -> None:
    # The motion from the state at 400 s is the same, also on which side of the separatrix it is.
    for spin in ([0.01, 0.08, 0.002], [0.002, -0.08, 0.01]):
        client = ffsms.Client(100.0, [60.0, 85.0, 120.0], POSE, [0.0, 0.0, 0.0, *spin])
        later = ffsms.Client(100.0, [60.0, 85.0, 120.0], client.pose(400.0), client.twist(400.0))
        for t in (3.0, 77.0, 500.0):
            np.testing.assert_allclose(later.pose(t).rotation, client.pose(400.0 + t).rotation, atol=1e-11)


def test_a_spin_about_the_intermediate_axis_stays_there_in_tilted_axes() -> None:
    inertia = TILT @ np.diag([60.0, 85.0, 120.0]) @ TILT.T
    omega = 0.08 * TILT[:, 1]
    client = ffsms.Client(100.0, 0.5 * (inertia + inertia.T), None, [0.0, 0.0, 0.0, *omega])
    np.testing.assert_allclose(client.twist(5000.0)[3:], omega, atol=1e-15)


def test_on_the_separatrix_the_spin_falls_to_the_intermediate_axis() -> None:
    # 2 (energy) / M^2 = 1 / (middle inertia): m_1^2 (1/I1 - 1/I2) = m_3^2 (1/I2 - 1/I3).
    moments = np.array([1.0, 2.0, 2.5])
    m = np.array([np.sqrt(0.1), 0.3, np.sqrt(0.5)])
    client = ffsms.Client(10.0, moments, None, [0.0, 0.0, 0.0, *(m / moments)])
    in_body = client.pose(20.0).rotation.T @ client.momentum[3:]
    assert abs(in_body[1]) == pytest.approx(np.linalg.norm(m), rel=1e-3)
