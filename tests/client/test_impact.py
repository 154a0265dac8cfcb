"""The capture of a client: momentum, final rates, and the motion afterwards compared with MuJoCo."""

from typing import Any

import mujoco as mj
import numpy as np
import pinocchio as pin
from engines import Mujoco

import ffsms_pin as ffsms
from ffsms_pin.capture.braking import brake
from ffsms_pin.client import AfterCapture, after_capture, rest_momentum
from ffsms_pin.simulation import Capture
from ffsms_pin.simulation.integrators import rk4_step

JOINTS = [0.3, -0.6, 0.2, -1.9, 0.4, 1.5, 0.8]
RATES = [0.02, -0.03, 0.01, 0.04, -0.02, 0.03, 0.05]


def _scene(momentum: bool = True) -> tuple[ffsms.SpaceManipulator, np.ndarray, np.ndarray, ffsms.Client]:
    """Return a moving servicer, and a tumbling client that moves relative to its end effector."""
    sms = ffsms.load("satellite_panda")
    q = sms.configuration(JOINTS, pin.SE3(pin.exp3(np.array([0.2, -0.4, 0.3])), np.array([0.5, 0.1, -0.2])))
    v = sms.velocity(q, RATES, [1.0, -2.0, 0.5, 0.3, 0.2, -0.6] if momentum else None)
    tip = sms.at(q).end_effector_pose
    grasp = pin.SE3(pin.exp3(np.array([0.1, 0.2, 0.3])), np.array([0.1, 0.2, -0.4]))
    twist = [0.02, -0.03, 0.01, 0.03, 0.05, -0.04]
    return sms, q, v, ffsms.Client(120.0, [9.0, 12.0, 15.0], tip * grasp.inverse(), twist)


def _about_origin(sms: ffsms.SpaceManipulator, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return the momentum about the inertial origin, link by link."""
    data, total = sms.model.createData(), np.zeros(6)
    pin.forwardKinematics(sms.model, data, q, v)
    for pose, motion, inertia in zip(data.oMi, data.v, sms.model.inertias, strict=True):
        total += pose.act(inertia * motion).vector
    return total


def _client_about_origin(client: ffsms.Client) -> np.ndarray:
    own = client.momentum
    return np.concatenate([own[:3], own[3:] + np.cross(client.start_pose.translation, own[:3])])


def test_the_total_momentum_is_kept() -> None:
    sms, q, v, client = _scene()
    after = after_capture(sms, q, v, client)
    before = _about_origin(sms, q, v) + _client_about_origin(client)
    total = _about_origin(after.robot, after.q, after.v)
    np.testing.assert_allclose(total, before, rtol=0.0, atol=1e-12 * np.abs(before).max())
    assert after.energy_lost > 0.0
    com = pin.centerOfMass(after.robot.model, after.robot.model.createData(), q)
    angular = before[3:] - np.cross(com, before[:3])
    np.testing.assert_allclose(
        after.momentum, [*before[:3], *angular], rtol=0.0, atol=1e-12 * np.abs(before).max()
    )


def test_the_event_of_a_simulation_is_the_same_capture() -> None:
    sms, q, v, client = _scene()
    in_gripper = sms.at(q).end_effector_pose.inverse() * client.start_pose
    tensor = in_gripper.rotation @ client.inertia @ in_gripper.rotation.T
    event = Capture(0.0, client.mass, tensor, in_gripper.translation, client.start_twist)
    plant, other = event.apply(sms, q, v, [])
    after = after_capture(sms, q, v, client)
    np.testing.assert_allclose(other, after.v, atol=1e-13)
    np.testing.assert_allclose(
        plant.model.inertias[8].inertia, after.robot.model.inertias[8].inertia, atol=1e-12
    )


def test_a_grasp_without_relative_velocity_does_not_change_the_motion() -> None:
    sms, q, v, client = _scene()
    state = sms.at(q, v)
    lever = client.start_pose.translation - state.end_effector_pose.translation
    twist = state.end_effector_twist
    moving = np.concatenate([twist[:3] + np.cross(twist[3:], lever), twist[3:]])
    after = after_capture(sms, q, v, ffsms.Client(client.mass, client.inertia, client.start_pose, moving))
    np.testing.assert_allclose(after.v, v, atol=1e-12)
    assert abs(after.energy_lost) < 1e-12


def test_a_joint_that_is_near_its_limit_stops_before_it() -> None:
    """The other joints brake longer; a note says if the acceleration does not suffice."""
    sms = ffsms.load("satellite_panda")
    joints, rates = np.array([0.0, -0.6, 0.0, -2.2, 0.0, 2.9, 0.8]), np.full(sms.n, 0.05)
    for gap, fragment in ((0.004, ""), (1e-5, "'panda_joint5' comes to rest")):
        joints[4] = sms.limits.upper[4] - gap
        q = sms.configuration(joints)
        state = sms.at(q, sms.velocity(q, rates))
        client = ffsms.Client(80.0, [6.0, 9.0, 11.0], state.end_effector_pose, state.end_effector_twist)
        braking = brake(after_capture(sms, q, sms.velocity(q, rates), client), share=10.0)
        assert fragment in braking.note
        assert (fragment == "") == (braking.note == "")
        moved = np.abs(sms.joint_positions(braking.q[-1]) - joints)
        stopped = np.argmax(braking.joint_rates == 0.0, axis=0)
        assert moved[4] < 0.006 < np.delete(moved, 4).max()
        assert stopped[4] < np.delete(stopped, 4).min()


def test_joints_at_rest_leave_the_predicted_rate() -> None:
    sms, q, v, client = _scene()
    after = after_capture(sms, q, v, client)
    braking = brake(after)
    assert braking.note == ""
    assert braking.torque_share <= 0.5
    assert (
        np.abs(np.diff(braking.joint_rates, axis=0)) <= sms.limits.acceleration * np.diff(braking.t)[:, None]
    ).all()
    end = braking.q[-1]
    still = after.robot.velocity(end, np.zeros(sms.n), after.momentum)
    spin = pin.XYZQUATToSE3(end[:7]).rotation @ still[3:6]
    np.testing.assert_allclose(after.rest_rate(end), spin, atol=1e-12)
    # The rate 20 s later follows from an integration, without the closed form of a free body.
    state: Any = end.copy(), still.copy()
    data = after.robot.model.createData()

    def rigid(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.concatenate([np.zeros(6), _held(after, q, v)])

    for _ in range(400):
        *state, _ = rk4_step(after.robot.model, data, state[0], state[1], rigid, 0.05)
    spin = pin.XYZQUATToSE3(state[0][:7]).rotation @ state[1][3:6]
    np.testing.assert_allclose(after.at_rest(end).twist(20.0)[3:], spin, atol=1e-7)


def _held(after: AfterCapture, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return joint torques that keep the joints at rest."""
    return after.robot.at(q, v).C_q


def test_the_rest_momentum_leaves_both_bodies_at_rest() -> None:
    sms, q, _, client = _scene()
    com = pin.centerOfMass(sms.model, sms.model.createData(), q)
    momentum = rest_momentum(client, com)
    after = after_capture(sms, q, sms.velocity(q, RATES, momentum), client)
    size = np.abs(client.momentum).max()
    np.testing.assert_allclose(after.momentum, np.zeros(6), atol=1e-12 * size)
    # The same momentum serves at any time: the servicer's centre of mass and the client have moved on.
    later = sms.configuration(JOINTS)
    later[:3] += com + 30.0 * momentum[:3] / pin.computeTotalMass(sms.model)
    captured_later = after_capture(sms, later, sms.velocity(later, RATES, momentum), client, 30.0)
    np.testing.assert_allclose(captured_later.momentum, np.zeros(6), atol=1e-12 * size)
    # Without this momentum both bodies keep turning.
    idle = after_capture(sms, q, sms.velocity(q, RATES), client)
    assert np.linalg.norm(idle.rest_rate()) > 0.01


def test_the_motion_after_a_capture_agrees_with_mujoco() -> None:
    """MuJoCo's model has the client's inertia on the last body, which is exact; 10 s under torques."""
    sms, q, v, client = _scene()
    after = after_capture(sms, q, v, client)
    tau = 0.02 * np.array([1.0, -1.0, 1.0, 0.5, -0.5, 0.3, 0.2])
    peer = Mujoco(after.robot, 2e-3)
    peer.model.opt.integrator = mj.mjtIntegrator.mjINT_RK4
    peer.set(after.q, after.v)
    state: Any = after.q, after.v
    data = after.robot.model.createData()
    force = np.concatenate([np.zeros(6), tau])
    peer.data.qfrc_applied[6:] = tau
    for _ in range(5000):
        mj.mj_step(peer.model, peer.data)
        *state, _ = rk4_step(after.robot.model, data, state[0], state[1], force, 2e-3)
    q_peer, v_peer = peer.state()
    difference = pin.difference(after.robot.model, state[0], q_peer)
    moved = pin.difference(after.robot.model, after.q, state[0])
    assert np.abs(moved).max() > 0.3
    assert np.abs(difference).max() <= 1e-6 * np.abs(moved).max()
    assert np.abs(v_peer - state[1]).max() <= 1e-6 * np.abs(v_peer).max()


def test_locked_joints_are_indices_of_velocities() -> None:
    sms, q, v, client = _scene()
    held = after_capture(sms, q, v, client, locked=[7, 9])
    assert held.v[[7, 9]].tolist() == [0.0, 0.0]
    assert held.v[8] != 0.0
