"""Compare the base motion under a joint motion with integrations by other methods."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

import ffsms_pin as ffsms
from ffsms_pin.errors import FfsmsError, InvalidValue
from ffsms_pin.robot.base_motion import advance, roll_out
from ffsms_pin.simulation.integrators import rk4_step


def test_base_motion_is_of_order_four(random_tree: Callable[..., Any]) -> None:
    sms = ffsms.SpaceManipulator(random_tree(5, 4, ("revolute", "prismatic")).model(), "tip")
    rng = np.random.default_rng(5)
    q0, rates = sms.configuration(rng.uniform(-1, 1, size=4)), rng.uniform(-1, 1, size=4)
    acceleration, duration, joints = rng.uniform(-1, 1, size=4), 1.0, sms.joint_positions

    # The reference is extrapolated from many small midpoint steps, with joint positions in closed form.
    def midpoint(steps: int) -> Any:
        dt, q = duration / steps, q0.copy()
        for k in range(steps):
            t = (k + 0.5) * dt
            q[7:] = joints(q0) + t * rates + 0.5 * t * t * acceleration
            v = sms.velocity(q, rates + t * acceleration)
            q[:7] = pin.SE3ToXYZQUAT(pin.XYZQUATToSE3(q[:7]) * pin.exp6(pin.Motion(v[:6] * dt)))
        return pin.XYZQUATToSE3(q[:7])

    coarse, fine = midpoint(400), midpoint(800)
    reference = fine * pin.exp6(pin.log6(coarse.inverse() * fine) * (1.0 / 3.0))
    errors = []
    for steps in (5, 10, 20):
        q, _ = roll_out(sms, q0, rates, np.tile(acceleration, (steps, 1)), duration / steps)
        errors.append(np.linalg.norm(pin.log6(reference.inverse() * pin.XYZQUATToSE3(q[-1][:7])).vector))
        np.testing.assert_allclose(joints(q[-1]), joints(q0) + rates + 0.5 * acceleration, atol=1e-14)
        np.testing.assert_allclose(np.linalg.norm(q[:, 3:7], axis=1), 1.0, atol=1e-14)
    assert errors[2] < 1e-6
    # Halving the step divides the error by about 16.
    assert 12.0 < errors[0] / errors[1] < 20.0
    assert 12.0 < errors[1] / errors[2] < 20.0


def test_centre_of_mass_stays(planar: ffsms.SpaceManipulator) -> None:
    q = planar.configuration([0.2, -0.4, 0.6])
    rates, acceleration = np.array([0.3, -0.2, 0.4]), np.array([0.1, 0.2, -0.3])
    for _ in range(50):
        q, rates = advance(planar, q, rates, acceleration, 0.02)
    np.testing.assert_allclose(planar.at(q).com, np.zeros(3), atol=1e-10)


# -- with momentum -------------------------------------------------------------------------------------

MOMENTUM = np.array([4.0, -2.0, 3.0, 1.0, -1.5, 2.0])


def free_flight(sms: ffsms.SpaceManipulator, q: Any, v: Any, acceleration: Any, duration: float) -> Any:
    """Return configuration and velocity after `duration`, by forward dynamics with joint torques."""
    model, data = sms.model, sms.model.createData()

    def slope(_: float, y: Any) -> Any:
        q, v = y[: sms.nq].copy(), y[sms.nq :]
        q[3:7] /= np.linalg.norm(q[3:7])
        # Only the joints are driven, so that they have the accelerations; the base acceleration follows.
        M, effects = pin.crba(model, data, q).copy(), pin.nonLinearEffects(model, data, q, v).copy()
        base = np.linalg.solve(M[:6, :6], -effects[:6] - M[:6, 6:] @ acceleration)
        tau = np.concatenate([np.zeros(6), M[6:, :6] @ base + M[6:, 6:] @ acceleration + effects[6:]])
        turn, (x, y_, z, w) = v[3:6], q[3:7]
        quaternion = 0.5 * np.append(w * turn + np.cross([x, y_, z], turn), -np.array([x, y_, z]) @ turn)
        origin = pin.XYZQUATToSE3(q[:7]).rotation @ v[:3]
        return np.concatenate([origin, quaternion, v[6:], pin.aba(model, data, q, v, tau)])

    end = solve_ivp(slope, (0.0, duration), np.concatenate([q, v]), "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    end[3:7] /= np.linalg.norm(end[3:7])
    return end[: sms.nq], end[sms.nq :]


def distance(a: Any, b: Any) -> float:
    return float(np.linalg.norm(pin.log6(pin.XYZQUATToSE3(a[:7]).inverse() * pin.XYZQUATToSE3(b[:7])).vector))


@pytest.mark.parametrize("seed", [5, 7, 8])
def test_tumbling_base_is_of_order_four(random_tree: Callable[..., Any], seed: int) -> None:
    sms = ffsms.SpaceManipulator(random_tree(seed, 4, ("revolute", "prismatic")).model(), "tip")
    rng = np.random.default_rng(seed)
    q0, rates = sms.configuration(rng.uniform(-1, 1, size=4)), rng.uniform(-1, 1, size=4)
    acceleration, duration = rng.uniform(-1, 1, size=4), 1.0
    q_end, v_end = free_flight(sms, q0, sms.velocity(q0, rates, MOMENTUM), acceleration, duration)
    errors = []
    for steps in (5, 10, 20):
        q, qd = roll_out(sms, q0, rates, np.tile(acceleration, (steps, 1)), duration / steps, MOMENTUM)
        errors.append(distance(q_end, q[-1]))
        np.testing.assert_allclose(np.linalg.norm(q[:, 3:7], axis=1), 1.0, atol=1e-14)
        # The system's centre of mass moves at constant velocity.
        mass = pin.computeTotalMass(sms.model)
        times = np.linspace(0.0, duration, steps + 1)
        coms = np.array([sms.at(row).com for row in q])
        np.testing.assert_allclose(coms, np.outer(times, MOMENTUM[:3] / mass) + coms[0], rtol=0.0, atol=1e-13)
    assert distance(q0, q_end) > 0.1
    assert errors[2] < 1e-7
    assert 14.0 < errors[0] / errors[1] < 18.0
    assert 14.0 < errors[1] / errors[2] < 18.0
    # The velocity for these joint rates and this momentum is that of the forward dynamics.
    np.testing.assert_allclose(sms.velocity(q[-1], qd[-1], MOMENTUM), v_end, rtol=0.0, atol=30.0 * errors[2])


def test_base_motion_with_momentum_agrees_with_the_simulation() -> None:
    # Without torques the joints drift; the base motion is rolled out from the simulated joint motion.
    sms = ffsms.load("satellite_panda")
    q0 = sms.configuration(0.5 * (sms.limits.lower + sms.limits.upper))
    momentum = np.array([2.0, -1.0, 1.0, 1.5, 2.0, -1.0])  # 2 to 3 degrees a second
    v0 = sms.velocity(q0, np.linspace(-0.1, 0.1, 7), momentum)
    errors: list[float] = []
    for steps in (100, 200):
        dt, data, q, v = 2.0 / steps, sms.model.createData(), q0.copy(), v0.copy()
        rates = [v[6:].copy()]
        for _ in range(steps):
            q, v, _ = rk4_step(sms.model, data, q, v, np.zeros(sms.nv), dt)
            rates.append(v[6:].copy())
        np.testing.assert_allclose(sms.at(q, v).momentum, momentum, rtol=0.0, atol=1e-8)
        rolled, _ = roll_out(sms, q0, rates[0], np.diff(rates, axis=0) / dt, dt, momentum)
        errors.append(distance(q, rolled[-1]))
        still, _ = roll_out(sms, q0, rates[0], np.diff(rates, axis=0) / dt, dt)
    assert distance(q, still[-1]) > 1e-2  # without momentum the base moves differently
    # Accelerations that are constant in each step approximate the joint motion to order 2.
    assert errors[0] < 1e-5
    assert 3.5 < errors[0] / errors[1] < 4.5


def test_finite_differences_of_the_motion_have_the_momentum(random_tree: Callable[..., Any]) -> None:
    # Velocities are finite differences of the configurations, independent of the momentum equation.
    sms = ffsms.SpaceManipulator(random_tree(3, 4, ("revolute", "prismatic")).model(), "tip")
    rng = np.random.default_rng(3)
    q0, dt, steps = sms.configuration(rng.uniform(-1, 1, size=4)), 2e-3, 300
    accelerations = np.tile(rng.uniform(-1, 1, size=4), (steps, 1))
    q, _ = roll_out(sms, q0, rng.uniform(-1, 1, size=4), accelerations, dt, MOMENTUM)
    data = sms.model.createData()
    for k in range(2, steps - 1, 20):
        inner = pin.difference(sms.model, q[k], q[k + 1]) - pin.difference(sms.model, q[k], q[k - 1])
        outer = pin.difference(sms.model, q[k], q[k + 2]) - pin.difference(sms.model, q[k], q[k - 2])
        v = (8.0 * inner - outer) / (12.0 * dt)
        h = pin.computeCentroidalMomentum(sms.model, data, q[k], v).vector
        np.testing.assert_allclose(h, MOMENTUM, rtol=0.0, atol=1e-6)


def test_zero_momentum_gives_the_same_bits_as_no_momentum(planar: ffsms.SpaceManipulator) -> None:
    q = planar.configuration([0.2, -0.4, 0.6])
    rates, accelerations = np.array([0.3, -0.2, 0.4]), np.tile([0.1, 0.2, -0.3], (5, 1))
    expected = roll_out(planar, q, rates, accelerations, 0.05)
    for a, b in zip(roll_out(planar, q, rates, accelerations, 0.05, np.zeros(6)), expected, strict=True):
        np.testing.assert_array_equal(a, b)
    # A tiny momentum selects the other code path, which has another integration error.
    other, _ = roll_out(planar, q, rates, accelerations, 0.05, np.full(6, 1e-12))
    np.testing.assert_allclose(other, expected[0], rtol=0.0, atol=1e-9)


def test_twists_with_momentum(random_tree: Callable[..., Any]) -> None:
    sms = ffsms.SpaceManipulator(random_tree(7, 5, ("revolute", "prismatic")).model(), "tip")
    rng = np.random.default_rng(7)
    base = pin.SE3(pin.rpy.rpyToMatrix(rng.uniform(-1, 1, size=3)), rng.uniform(-1, 1, size=3))
    q, rates = sms.configuration(rng.uniform(-1, 1, size=5), base), rng.uniform(-1, 1, size=5)
    state = sms.at(q, sms.velocity(q, rates, MOMENTUM))
    # v_b = C_bm qd + H_b^-1 h, h about the base's centre of mass.
    h = MOMENTUM.copy()
    h[3:] += np.cross(state.com - state.base_pose.translation, h[:3])
    np.testing.assert_allclose(state.drift_twist, np.linalg.solve(state.H_b, h), rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(state.base_twist, state.C_bm @ rates + state.drift_twist, atol=1e-15)
    np.testing.assert_allclose(
        state.end_effector_twist, state.J_star @ rates + state.J_b @ state.drift_twist, rtol=0.0, atol=1e-13
    )
    data = sms.model.createData()
    pin.forwardKinematics(sms.model, data, q, state.v)
    axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    expected = pin.getFrameVelocity(sms.model, data, sms.frame_id, axes).vector
    np.testing.assert_allclose(state.end_effector_twist, expected, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(sms.at(q, sms.velocity(q, rates)).drift_twist, 0.0, atol=1e-14)


@pytest.mark.parametrize("momentum", [1.0, [1.0] * 5, [np.nan] * 6, "momentum", [[1.0] * 6]])
def test_wrong_momentum(
    planar: ffsms.SpaceManipulator, refused: Callable[..., FfsmsError], momentum: Any
) -> None:
    q, zero = planar.configuration([0.1, 0.2, 0.3]), np.zeros(3)
    refused(lambda: advance(planar, q, zero, zero, 0.01, momentum), InvalidValue, "momentum must")
    refused(
        lambda: roll_out(planar, q, zero, np.zeros((1, 3)), 0.01, momentum), InvalidValue, "momentum must"
    )


def test_the_quaternion_stays_normalised() -> None:
    """Test long motions of a heavy arm, because rounding errors of the quaternion could grow."""
    sms = ffsms.load("space_arm_7")
    rng, start = np.random.default_rng(1), np.array([0.0, 0.6, 0.0, 1.2, 0.0, 0.6, 0.0])
    for _ in range(60):
        move = 0.9 * sms.limits.upper * rng.uniform(-1.0, 1.0, 7) - start
        q, _ = roll_out(sms, sms.configuration(start), move, np.zeros((120, 7)), 1.0 / 120)
        assert np.abs(np.linalg.norm(q[:, 3:7], axis=1) - 1.0).max() < 1e-14
