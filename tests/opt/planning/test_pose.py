"""Pose targets: position and orientation, in the plane and in space."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.errors import InvalidValue


@pytest.fixture(scope="module")
def xarm() -> ffsms.SpaceManipulator:
    return ffsms.load("satellite_xarm7")


def nearby_pose(sms: ffsms.SpaceManipulator, start: np.ndarray, change: np.ndarray) -> pin.SE3:
    """Return the end effector's pose after a joint motion of the floating robot."""
    q0 = sms.configuration(start)
    # The momentum is zero; the base motion is integrated in small steps.
    q, steps = q0, 200
    for _ in range(steps):
        v = sms.velocity(q, change / steps)
        q = pin.integrate(sms.model, q, v)
    return sms.at(q).end_effector_pose


def test_a_seven_joint_arm_reaches_a_nearby_pose(xarm: ffsms.SpaceManipulator) -> None:
    middle = 0.5 * (xarm.limits.lower + xarm.limits.upper)
    start = middle + 0.15 * (xarm.limits.upper - middle)
    change = np.array([0.2, -0.3, 0.2, 0.3, -0.2, 0.3, 0.4])
    target = nearby_pose(xarm, start, change)
    plan = opt.plan(xarm, xarm.configuration(start), target, duration=10.0, dt=0.02, method="step")
    assert plan.reached
    assert plan.position_error[-1] < 1e-3
    assert plan.orientation_error[-1] < 1e-3
    end = xarm.at(plan.q[-1]).end_effector_pose
    assert np.linalg.norm(pin.log6(end.actInv(target)).vector) < 2e-3
    assert (np.abs(plan.joint_rates) <= xarm.limits.velocity + 1e-12).all()
    assert (np.abs(plan.joint_accelerations) <= xarm.limits.acceleration + 1e-9).all()
    # A plan to the position alone ends with another attitude.
    free = opt.plan(
        xarm, xarm.configuration(start), target.translation, duration=10.0, dt=0.02, method="step"
    )
    assert free.reached
    end_free = xarm.at(free.q[-1]).end_effector_pose
    assert np.linalg.norm(pin.log3(target.rotation @ end_free.rotation.T)) > 0.05


def test_the_planar_arm_reaches_a_pose(planar: ffsms.SpaceManipulator) -> None:
    start = np.array([0.4, 0.7, -0.5])
    target = nearby_pose(planar, start, np.array([0.3, -0.2, 0.4]))
    plan = opt.plan(planar, planar.configuration(start), target, duration=6.0, dt=0.02, method="step")
    assert plan.reached
    assert plan.position_error[-1] < 1e-3
    assert plan.orientation_error[-1] < 1e-3


def test_a_plan_that_misses_the_attitude_is_not_reached(planar: ffsms.SpaceManipulator) -> None:
    q0 = planar.configuration([0.4, 0.7, -0.5])
    here = planar.at(q0).end_effector_pose
    tilted = pin.SE3(pin.utils.rotate("x", 1.0) @ here.rotation, here.translation)  # out of the plane
    plan = opt.plan(planar, q0, tilted, duration=3.0, dt=0.05, method="step")
    assert not plan.reached
    assert plan.orientation_error[-1] == pytest.approx(1.0, abs=0.05)


def test_a_matrix_that_is_no_rotation_is_refused(planar: ffsms.SpaceManipulator) -> None:
    scaled = pin.SE3(1.1 * np.eye(3), np.zeros(3))
    with pytest.raises(InvalidValue, match=r"target\.rotation"):
        opt.plan(planar, planar.configuration([0, 0, 0]), scaled)
    mirror = pin.SE3(np.diag([1.0, 1.0, -1.0]), np.zeros(3))
    with pytest.raises(InvalidValue, match=r"target\.rotation"):
        opt.plan(planar, planar.configuration([0, 0, 0]), mirror)
