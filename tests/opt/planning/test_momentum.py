"""Plans with a constant total momentum of a drifting and tumbling satellite."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.trajectory import measure
from ffsms_pin.robot.base_motion import roll_out
from ffsms_pin.simulation import JointFriction

Array = NDArray[np.float64]
Setting = tuple[ffsms.SpaceManipulator, Array, Array, Array]

DURATION, DT = 8.0, 0.02


def slow_tumble(sms: ffsms.SpaceManipulator, q0: Array) -> Array:
    """Return a momentum that moves the system by about 6 cm and turns it by about 8 deg in DURATION."""
    state = sms.at(q0)
    mass, inertia = state.H[0, 0], state.H[3:6, 3:6]
    planar = sms.n == 3
    velocity = np.array([0.006, -0.005, 0.0 if planar else 0.004])
    spin = np.array([0.0, 0.0, 0.018]) if planar else np.array([0.008, -0.01, 0.012])
    return np.concatenate([mass * velocity, inertia @ spin])


@pytest.fixture(scope="module", params=["planar_3r", "satellite_xarm7"])
def setting(request: pytest.FixtureRequest) -> Setting:
    """A robot, its start, a target and a momentum."""
    sms = ffsms.load(request.param)
    if sms.n == 3:
        q0, displacement = sms.configuration([0.3, 0.6, 0.5]), np.array([-0.2, 0.15, 0.0])
    else:
        base = pin.SE3(pin.rpy.rpyToMatrix(0.4, -0.7, 1.1), np.array([0.5, -0.2, 0.3]))
        q0 = sms.configuration([0.2, -0.5, 0.3, 1.2, 0.2, 0.9, 0.1], base)
        displacement = base.rotation @ np.array([-0.1, 0.2, 0.15])
    target = sms.at(q0).end_effector_pose.translation + displacement
    return sms, q0, target, slow_tumble(sms, q0)


@pytest.fixture(scope="module")
def step_plan(setting: Setting) -> opt.Trajectory:
    """The plan by steps, with the momentum."""
    sms, q0, target, momentum = setting
    return opt.plan(sms, q0, target, DURATION, DT, method="step", momentum=momentum)


def momenta(sms: ffsms.SpaceManipulator, plan: opt.Trajectory) -> Array:
    """Return the total momentum at every node (N + 1, 6) by Pinocchio."""
    data = sms.model.createData()
    pairs = zip(plan.q, plan.v, strict=True)
    return np.array([pin.computeCentroidalMomentum(sms.model, data, q, v).vector.copy() for q, v in pairs])


@pytest.mark.parametrize("method", ["horizon", "step"])
def test_plans_with_momentum_reach_the_target(
    method: str, setting: Setting, step_plan: opt.Trajectory
) -> None:
    sms, q0, target, momentum = setting
    plan = step_plan
    if method == "horizon":
        plan = opt.plan(sms, q0, target, DURATION, DT, momentum=momentum, time_limit=1e-9)
    assert plan.reached
    np.testing.assert_array_equal(plan.momentum, momentum)
    np.testing.assert_allclose(momenta(sms, plan), np.tile(momentum, (len(plan.t), 1)), atol=1e-9)

    # A rollout of the accelerations in finer steps ends at the same configuration.
    fine = 4
    q, rates = roll_out(
        sms, q0, plan.joint_rates[0], np.repeat(plan.joint_accelerations, fine, axis=0), DT / fine, momentum
    )
    np.testing.assert_allclose(plan.q[-1], q[-1], atol=1e-6)
    np.testing.assert_allclose(plan.joint_rates[-1], rates[-1], atol=1e-9)
    end = sms.at(q[-1]).end_effector_pose.translation
    assert np.linalg.norm(end - target) < 2e-3

    # A plan without the momentum misses the target by centimetres.
    quick: dict[str, Any] = {"time_limit": 1e-9} if method == "horizon" else {}
    uninformed = opt.plan(sms, q0, target, DURATION, DT, method=method, **quick)
    assert uninformed.reached
    q, _ = roll_out(sms, q0, uninformed.joint_rates[0], uninformed.joint_accelerations, DT, momentum)
    assert np.linalg.norm(sms.at(q[-1]).end_effector_pose.translation - target) > 0.03


def test_velocities_agree_with_differences_of_configurations(
    setting: Setting, step_plan: opt.Trajectory
) -> None:
    sms, plan = setting[0], step_plan
    for k in range(1, len(plan.t) - 1, 40):
        both = (
            pin.difference(sms.model, plan.q[k - 1], plan.q[k]),
            pin.difference(sms.model, plan.q[k], plan.q[k + 1]),
        )
        means = 0.5 * (plan.v[k - 1] + plan.v[k]), 0.5 * (plan.v[k] + plan.v[k + 1])
        for difference, mean in zip(both, means, strict=True):
            np.testing.assert_allclose(difference / DT, mean, atol=2e-5)


def test_a_pose_is_reached_with_momentum() -> None:
    sms = ffsms.load("satellite_xarm7")
    q0 = sms.configuration([0.2, -0.5, 0.3, 1.2, 0.2, 0.9, 0.1])
    pose = sms.at(q0).end_effector_pose.copy()
    pose.translation = pose.translation + np.array([-0.1, 0.15, 0.05])
    pose.rotation = pose.rotation @ pin.rpy.rpyToMatrix(0.2, -0.1, 0.3)
    momentum = slow_tumble(sms, q0)
    plan = opt.plan(sms, q0, pose, DURATION, DT, momentum=momentum, time_limit=1e-9)
    assert plan.reached
    assert plan.position_error[-1] < 2e-3
    assert plan.orientation_error[-1] < 5e-3


def test_an_arm_at_its_target_moves_against_the_drift_of_the_base(planar: ffsms.SpaceManipulator) -> None:
    q0 = planar.configuration([0.3, 0.6, 0.5])
    target, momentum = planar.at(q0).end_effector_pose.translation, slow_tumble(planar, q0)
    plan = opt.plan(planar, q0, target, DURATION, DT, method="step", momentum=momentum)
    assert plan.reached
    assert np.abs(plan.joint_positions[-1] - plan.joint_positions[0]).max() > 0.05
    still = opt.plan(planar, q0, target, DURATION, DT, momentum=np.zeros(6))
    np.testing.assert_array_equal(still.joint_positions[-1], still.joint_positions[0])


def test_base_limits_with_momentum(planar: ffsms.SpaceManipulator) -> None:
    """The drift alone violates a narrow limit, which the note reports."""
    q0 = planar.configuration([0.3, 0.6, 0.5])
    target = planar.at(q0).end_effector_pose.translation + np.array([-0.1, 0.1, 0.0])
    momentum = slow_tumble(planar, q0)
    wide, narrow = opt.BaseLimits(translation=0.4), opt.BaseLimits(translation=0.01)
    options: dict[str, Any] = {"momentum": momentum, "time_limit": 1e-9}
    assert opt.plan(planar, q0, target, DURATION, DT, base_limits=wide, **options).reached
    plan = opt.plan(planar, q0, target, DURATION, DT, method="step", momentum=momentum, base_limits=narrow)
    assert not plan.reached
    assert "its limit is 0.01 m" in plan.note


def test_save_and_load(planar: ffsms.SpaceManipulator, tmp_path: Path) -> None:
    q0, momentum = planar.configuration([0.3, 0.6, 0.5]), np.array([0.1, 0.2, 0.0, 0.0, 0.0, 0.05])
    rates = np.zeros((11, 3))
    plan = measure(opt.Problem(planar, q0, [0.7, 0.3, 0.0], 1.0, 0.1, momentum=momentum), rates)
    # The joints are at rest and the base moves.
    assert np.linalg.norm(plan.q[-1, :3] - plan.q[0, :3]) > 1e-3
    np.testing.assert_allclose(momenta(planar, plan), np.tile(momentum, (11, 1)), atol=1e-12)
    plan.save(tmp_path / "plan.npz")
    again = opt.Trajectory.load(tmp_path / "plan.npz")
    np.testing.assert_array_equal(again.momentum, momentum)
    np.testing.assert_array_equal(again.v, plan.v)


def test_a_simulation_keeps_the_momentum_and_arrives(setting: Setting, step_plan: opt.Trajectory) -> None:
    """The plant starts with the plan's momentum unless `Conditions.momentum` is set."""
    sms, _, _, momentum = setting
    plan = step_plan
    law, smooth = ffsms.SlidingModeController(sms), JointFriction()
    track = ffsms.simulate(sms, plan, law, dt=5e-3, conditions=ffsms.Conditions(friction=smooth))
    np.testing.assert_allclose(track.momentum, np.tile(momentum, (len(track.t), 1)), atol=1e-9)
    assert track.position_error[-1] < 5e-3
    rest = ffsms.simulate(
        sms,
        plan,
        law,
        dt=5e-3,
        conditions=ffsms.Conditions(momentum=np.zeros(6), friction=smooth),
    )
    assert np.abs(rest.momentum).max() < 1e-9
    assert rest.position_error[-1] > 0.03


def test_replanning_with_momentum(planar: ffsms.SpaceManipulator) -> None:
    q0 = planar.configuration([0.3, 0.6, 0.5])
    target = planar.at(q0).end_effector_pose.translation + np.array([-0.2, 0.15, 0.0])
    momentum = slow_tumble(planar, q0)
    planner = opt.StepPlanner(planar, 0.02, momentum=momentum)
    reference = planner.track(target, DURATION)
    track = ffsms.simulate(planar, reference, ffsms.SlidingModeController(planar), dt=5e-3, q0=q0)
    np.testing.assert_allclose(track.momentum[-1], momentum, atol=1e-9)
    assert track.position_error[-1] < 2e-3


@pytest.mark.parametrize("momentum", [[1.0, 2.0], [np.nan] * 6, "fast"])
def test_momentum_is_checked(momentum: object, planar: ffsms.SpaceManipulator) -> None:
    q0 = planar.configuration([0.1, 0.2, 0.3])
    with pytest.raises(InvalidValue, match="momentum"):
        opt.plan(planar, q0, [0.9, 0.2, 0.0], momentum=momentum)  # type: ignore[arg-type]
    with pytest.raises(InvalidValue, match="momentum"):
        opt.StepPlanner(planar, momentum=momentum)  # type: ignore[arg-type]


def test_the_papers_method_refuses_momentum(planar: ffsms.SpaceManipulator) -> None:
    q0 = planar.configuration([0.1, 0.2, 0.3])
    with pytest.raises(InvalidValue, match="does not support momentum"):
        opt.plan(planar, q0, [0.9, 0.2, 0.0], method="paper", momentum=[1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
