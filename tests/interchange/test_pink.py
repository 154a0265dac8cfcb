"""Pink's tasks on the floating robot: momentum is kept, frames move by J*, limits hold."""

from __future__ import annotations

import numpy as np
import pink
import pinocchio as pin
import pytest
from motions import Array
from pink.tasks import FrameTask, PostureTask

import ffsms_pin as ffsms
from ffsms_pin.interchange.pink import FloatingConfiguration, MomentumTask

DT = 0.02


def start(name: str) -> tuple[ffsms.SpaceManipulator, Array]:
    sms = ffsms.load(name)
    return sms, sms.configuration(np.linspace(0.3, 0.7, sms.n))


def moved(sms: ffsms.SpaceManipulator, q: Array, by: Array) -> pin.SE3:
    here = sms.at(q).end_effector_pose
    return pin.SE3(here.rotation, here.translation + by)


@pytest.mark.parametrize("name", ["planar_3r", "space_arm_7"])
def test_a_frame_task_arrives_while_the_base_reacts(name: str) -> None:
    sms, q = start(name)
    target = moved(sms, q, np.array([-0.1, 0.05, 0.0]))
    hand = FrameTask(sms.end_effector, position_cost=1.0, orientation_cost=0.0, gain=0.1)
    hand.set_target(target)
    momentum = MomentumTask(sms, DT)
    configuration = FloatingConfiguration(sms, sms.at(q))
    for _ in range(150):
        v = pink.solve_ik(configuration, [hand], DT, "proxqp", constraints=[momentum], eps_abs=1e-10)
        here = np.array(configuration.q)
        A = pin.computeCentroidalMap(sms.model, sms.model.createData(), here)
        # The solver's tolerance is what is left of the momentum that the joints alone would make.
        assert np.abs(A @ v).max() <= 1e-4 * np.abs(A[:, 6:] @ v[6:]).max() + 1e-7
        assert np.all(np.abs(v[6:]) <= sms.limits.velocity * (1.0 + 1e-6))
        state = sms.at(here)
        data = sms.model.createData()
        pin.computeJointJacobians(sms.model, data, here)
        pin.updateFramePlacements(sms.model, data)
        J = pin.getFrameJacobian(sms.model, data, sms.frame_id, pin.LOCAL_WORLD_ALIGNED)
        np.testing.assert_allclose(J @ v, state.J_star @ v[6:], atol=1e-6)
        configuration.integrate_inplace(v, DT)
    at_end = configuration.state
    assert np.linalg.norm(at_end.end_effector_pose.translation - target.translation) < 1e-3
    assert np.linalg.norm(pin.log3(at_end.base_pose.rotation)) > 1e-3  # the base did react
    assert np.linalg.norm(at_end.com - sms.at(q).com) < 1e-6  # as nothing pushed


def test_without_the_constraint_the_base_is_pushed_by_nobody() -> None:
    sms, q = start("space_arm_7")
    hand = FrameTask(sms.end_effector, position_cost=1.0, orientation_cost=1.0)
    hand.set_target(moved(sms, q, np.array([-0.1, 0.05, 0.0])))
    v = pink.solve_ik(FloatingConfiguration(sms, q), [hand], DT, "proxqp")
    assert np.abs(pin.computeCentroidalMap(sms.model, sms.model.createData(), q) @ v).max() > 1.0


def test_a_posture_task_moves_in_what_the_hand_leaves_free() -> None:
    sms, q = start("space_arm_7")
    here = sms.at(q).end_effector_pose
    hand = FrameTask(sms.end_effector, position_cost=100.0, orientation_cost=100.0)
    hand.set_target(here)
    wanted = sms.configuration(np.linspace(0.3, 0.7, 7) + np.array([0.2, 0, 0, 0, 0, 0, 0]))
    posture = PostureTask(cost=1.0, gain=0.1)
    posture.set_target(wanted)
    configuration = FloatingConfiguration(sms, q)
    for _ in range(60):
        v = pink.solve_ik(
            configuration, [hand, posture], DT, "proxqp", constraints=[MomentumTask(sms, DT)], eps_abs=1e-10
        )
        configuration.integrate_inplace(v, DT)
    assert np.linalg.norm(configuration.state.end_effector_pose.translation - here.translation) < 1e-3
    assert np.linalg.norm(configuration.q[7:] - wanted[7:]) < 0.95 * np.linalg.norm(q[7:] - wanted[7:])
    assert np.linalg.norm(configuration.q[7:] - q[7:]) > 0.01


def test_momentum_carries_the_base() -> None:
    """An arm that holds its joints on a drifting, turning satellite: the base goes on by itself."""
    sms, q = start("planar_3r")
    momentum = np.array([0.5, -0.2, 0.0, 0.0, 0.0, 0.1])
    still = PostureTask(cost=1.0)
    still.set_target(q)
    configuration = FloatingConfiguration(sms, q, momentum)
    task = MomentumTask(sms, DT, momentum)
    for _ in range(50):
        v = pink.solve_ik(configuration, [still], DT, "proxqp", constraints=[task], eps_abs=1e-10)
        configuration.integrate_inplace(v, DT)
        expected = sms.velocity(np.array(configuration.q), np.zeros(3), momentum)
    mass = sum(inertia.mass for inertia in sms.model.inertias)
    np.testing.assert_allclose(configuration.state.com - sms.at(q).com, momentum[:3] / mass, atol=1e-6)
    np.testing.assert_allclose(v[:6], expected[:6], atol=1e-3)


def test_integration_is_of_second_order() -> None:
    sms, q = start("space_arm_7")
    v = np.concatenate([np.zeros(6), np.linspace(0.5, -0.5, 7)])

    def end(steps: int) -> Array:
        configuration = FloatingConfiguration(sms, q)
        for _ in range(steps):
            configuration.integrate_inplace(v, 1.0 / steps)
        return np.array(configuration.q)

    exact = end(512)
    coarse, fine = (np.abs(end(k) - exact).max() for k in (8, 32))
    assert 10.0 < coarse / fine < 24.0  # 16: of second order


def test_the_robot_s_own_model_is_left_alone() -> None:
    sms, q = start("planar_3r")
    FloatingConfiguration(sms, q)
    assert not hasattr(sms.model, "tangent")
