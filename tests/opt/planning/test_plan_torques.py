"""The torques of a plan agree with Pinocchio's forward and inverse dynamics without a base wrench."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from rails import sliding

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.trajectory import measure


def _planar(tmp_path: Path) -> opt.Trajectory:
    sms = ffsms.load("planar_3r")
    return opt.plan(sms, sms.configuration([0.4, 0.7, -0.5]), [0.7, 0.5, 0.0], 4.0, 0.02)


def _drifting(tmp_path: Path) -> opt.Trajectory:
    sms = ffsms.load("planar_3r")
    momentum = [0.5, 0.0, 0.0, 0.0, 0.0, 0.3]
    return opt.plan(sms, sms.configuration([0.02] * 3), [1.0, 0.15, 0.0], 6.0, momentum=momentum)


def _geared(tmp_path: Path) -> opt.Trajectory:
    """Return a plan of an arm with rotor inertias."""
    model = ffsms.load("satellite_panda").model.copy()
    model.armature = np.concatenate([np.zeros(6), np.linspace(0.1, 3.0, 7)])
    sms = ffsms.SpaceManipulator(model, "panda_hand_tcp", base_size=(1.0, 1.0, 1.0))
    q0 = sms.configuration([0.0, -0.6, 0.0, -2.2, 0.0, 1.8, 0.8])
    target = sms.at(q0).end_effector_pose.translation + np.array([-0.1, 0.2, 0.1])
    return opt.plan(sms, q0, target, 6.0, 0.05)


def _sliding(tmp_path: Path) -> opt.Trajectory:
    sms = sliding(tmp_path)
    target = sms.at(sms.configuration([0.4, 0.5])).end_effector_pose.translation
    return opt.plan(sms, sms.configuration([0.0, 0.1]), target, 10.0, 0.05)


@pytest.fixture(
    scope="module", params=[_planar, _drifting, _geared, _sliding], ids=lambda make_plan: make_plan.__name__
)
def plan(request: Any, tmp_path_factory: pytest.TempPathFactory) -> opt.Trajectory:
    make_plan: Callable[[Path], opt.Trajectory] = request.param
    return make_plan(tmp_path_factory.mktemp("robots"))


def _robot(plan: opt.Trajectory) -> ffsms.SpaceManipulator:
    assert plan.problem is not None
    return plan.problem.sms


def test_forward_dynamics_give_the_accelerations_of_the_plan(plan: opt.Trajectory) -> None:
    """Apply ABA with these torques and no wrench on the base at every node."""
    sms = _robot(plan)
    data = sms.model.createData()
    assert plan.tau.shape == (len(plan.t), sms.n)
    after = np.vstack([plan.joint_accelerations, plan.joint_accelerations[-1:]])
    for q, v, tau, acceleration in zip(plan.q, plan.v, plan.tau, after, strict=True):
        result = pin.aba(sms.model, data, q, v, np.concatenate([np.zeros(6), tau]))
        np.testing.assert_allclose(result[6:], acceleration, rtol=0.0, atol=1e-8)


def test_inverse_dynamics_by_differences_give_the_torques(plan: opt.Trajectory) -> None:
    """Apply RNEA with the base's acceleration by differences; the wrench on the base is zero."""
    sms, h = _robot(plan), 1e-5
    data = sms.model.createData()
    for k in (0, len(plan.t) // 3, len(plan.t) - 2):
        q, v, acceleration = plan.q[k], plan.v[k], plan.joint_accelerations[k]
        velocities = []
        for dt in (-h, h):
            there = pin.integrate(sms.model, q, dt * v)
            velocities.append(sms.velocity(there, v[6:] + dt * acceleration, plan.momentum))
        force = pin.rnea(sms.model, data, q, v, (velocities[1] - velocities[0]) / (2.0 * h))
        size = max(np.abs(plan.tau).max(), 1e-3)
        np.testing.assert_allclose(force[6:], plan.tau[k], rtol=0.0, atol=1e-6 * size)
        np.testing.assert_allclose(force[:6], 0.0, rtol=0.0, atol=1e-5 * size)


def test_torque_shares_agree_with_the_torques(plan: opt.Trajectory) -> None:
    share = np.abs(plan.tau) / _robot(plan).limits.torque
    assert (plan.torque_share >= share - 1e-12).all()
    np.testing.assert_allclose(plan.torque_share[[0, -1]], share[[0, -1]], rtol=0.0, atol=1e-12)


def test_a_file_keeps_the_torques(plan: opt.Trajectory, tmp_path: Path) -> None:
    plan.save(tmp_path / "plan.npz")
    loaded = opt.Trajectory.load(tmp_path / "plan.npz")
    np.testing.assert_array_equal(loaded.tau, plan.tau)
    assert loaded.base_pose(3).isApprox(plan.base_pose(3), 0.0)


def test_the_base_pose_agrees_with_the_state(plan: opt.Trajectory) -> None:
    for k in (0, 7, -1):
        assert plan.base_pose(k).isApprox(_robot(plan).at(plan.q[k]).base_pose, 1e-12)


@pytest.mark.parametrize("k", [10_000, -10_000, 1.5, None])
def test_a_node_out_of_range_is_refused(plan: opt.Trajectory, k: Any) -> None:
    with pytest.raises(InvalidValue, match=r"^k must be a node of the motion, from -"):
        plan.base_pose(k)


def test_violations_of_sliding_joints_are_in_metres(tmp_path: Path) -> None:
    sms = sliding(tmp_path)
    problem = opt.Problem(sms, sms.configuration([0.0, 0.0]), [0.8, 0.0, 0.6], 4.0, 0.1)
    rates = np.zeros((problem.steps + 1, 2))
    rates[10:-10, 0] = 0.25
    note = measure(problem, rates).note
    assert "the rate limit of 'rail' is violated by 0.05 m/s at" in note
    assert "m/s^2" in note
