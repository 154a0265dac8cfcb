"""Re-planning in the closed loop: moving targets, poses, base limits and momentum."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from replanned import CASES, run

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.control import ComputedTorque
from ffsms_pin.errors import FfsmsError, InvalidValue
from ffsms_pin.simulation import Conditions, JointFriction, perturb, random_plants, simulate

Array = NDArray[np.float64]
DEGREE = np.pi / 180.0


@pytest.mark.slow
def test_a_moving_target_is_met_with_its_velocity(planar: ffsms.SpaceManipulator) -> None:
    def target(t: float) -> Array:
        angle = 0.05 * t
        return np.array([0.62 * np.cos(angle) + 0.25, 0.62 * np.sin(angle) - 0.05, 0.0])

    _, tracking = run(planar, target, 8.0, hold=3.0)
    assert tracking.t[-1] == 11.0
    k = int(np.searchsorted(tracking.t, 8.0))
    assert tracking.position_error[k] < 2e-3
    velocity = planar.at(tracking.q[k], tracking.v[k]).J_star[:3] @ tracking.v[k, 6:]
    velocity_target = (target(8.01) - target(7.99)) / 0.02
    np.testing.assert_allclose(velocity, velocity_target, atol=5e-3)
    assert np.linalg.norm(velocity_target) > 0.03
    assert tracking.position_error[tracking.t > 8.5].max() < 1e-3


def test_a_goal_with_a_velocity_is_passed_with_it(planar: ffsms.SpaceManipulator) -> None:
    velocity_target = np.array([0.0, 0.03, 0.0])
    goal = opt.Position([0.75, 0.5, 0.0], velocity=velocity_target)
    _, tracking = run(planar, goal, 6.0, hold=2.0, plant=perturb(planar, arm_mass=1.1))
    k = int(np.searchsorted(tracking.t, 6.0))
    assert tracking.position_error[k] < 2e-3
    velocity = planar.at(tracking.q[k], tracking.v[k]).J_star[:3] @ tracking.v[k, 6:]
    np.testing.assert_allclose(velocity, velocity_target, atol=2e-3)
    assert tracking.position_error[-1] < 2e-3  # and returns


def test_target_is_held_after_arrival(planar: ffsms.SpaceManipulator) -> None:
    reference, tracking = run(planar, CASES[1], 10.0, hold=3.0)
    assert tracking.position_error[tracking.t >= 10.0].max() < 1e-3
    assert reference.mode == "hold"


@pytest.mark.long
@pytest.mark.slow
def test_pose_targets_are_tracked(planar: ffsms.SpaceManipulator) -> None:
    end = planar.configuration([0.4, 0.6, 0.3])
    pose = planar.at(end).end_effector_pose
    target = pin.SE3(pose.rotation, pose.translation)
    plant = perturb(planar, arm_mass=1.1)
    reference, tracking = run(
        planar, target, 9.0, plant=plant, guards=None
    )  # rates are 13 % above their limit
    assert tracking.position_error[-1] < 2e-3
    reached = planar.at(tracking.q[-1]).end_effector_pose
    assert np.linalg.norm(pin.log3(reached.rotation.T @ pose.rotation)) < 0.05
    assert reference.failed_steps == 0


def test_wrong_targets_and_times_are_refused(
    planar: ffsms.SpaceManipulator, refused: Callable[..., FfsmsError]
) -> None:
    planner = opt.StepPlanner(planar)
    refused(lambda: planner.track(np.zeros(2), 1.0), InvalidValue, "target")
    refused(lambda: planner.track(np.zeros(3), 0.0), InvalidValue, "duration")
    refused(lambda: planner.track(np.zeros(3), 1.0, hold=-1.0), InvalidValue, "hold")
    refused(lambda: planner.track(lambda t: np.zeros(2), 1.0), InvalidValue, "target")


@pytest.mark.slow
@pytest.mark.long
def test_base_limits_are_kept_in_the_closed_loop() -> None:
    """The plant is wrong; the limit counts from the initial base pose."""
    sms, limit = ffsms.load("satellite_xarm7"), 1.0 * DEGREE
    base = pin.SE3(pin.rpy.rpyToMatrix(0.4, -0.7, 1.1), np.array([0.5, -0.2, 0.3]))
    q0 = sms.configuration([0.2, -0.5, 0.3, 1.2, 0.2, 0.9, 0.1], base)
    target = sms.at(q0).end_effector_pose.translation + base.rotation @ np.array([-0.1, 0.25, 0.15])
    plant = perturb(sms, arm_mass=1.1)
    largest, miss = {}, {}
    for limits in (None, opt.BaseLimits(attitude=limit)):
        reference = opt.StepPlanner(sms, 0.02, base_limits=limits).track(target, 6.0)
        law = ComputedTorque(sms, 100.0, 20.0, coulomb=0.0, viscous=0.0)
        smooth = Conditions(friction=JointFriction())
        track = simulate(sms, reference, law, dt=5e-3, q0=q0, plant=plant, conditions=smooth)
        first = pin.XYZQUATToSE3(q0[:7]).rotation.T
        turns = [pin.log3(first @ pin.XYZQUATToSE3(q[:7]).rotation) for q in track.q]
        largest[limits], miss[limits] = float(np.linalg.norm(turns, axis=1).max()), track.position_error[-1]
    free, limited = largest.values()
    assert free > 1.2 * limit
    assert 0.5 * limit < limited <= limit
    assert max(miss.values()) < 2e-3


@pytest.mark.long
@pytest.mark.slow
def test_a_base_limit_that_changes_the_path_is_kept() -> None:
    """Move by 0.5 m with the base within 3 degrees on a wrong plant."""
    sms, limit = ffsms.load("satellite_panda"), 3.0 * DEGREE
    q0 = sms.configuration(0.5 * (sms.limits.lower + sms.limits.upper))
    target = sms.at(q0).end_effector_pose.translation + np.array([-0.15, 0.35, -0.25])
    plant = list(random_plants(sms, np.random.default_rng(1), 10))[9]
    reference = opt.StepPlanner(sms, 0.02, base_limits=opt.BaseLimits(attitude=limit)).track(target, 12.0)
    track = simulate(sms, reference, ComputedTorque(sms, 100.0, 20.0), dt=4e-3, q0=q0, plant=plant)
    first = pin.XYZQUATToSE3(q0[:7]).rotation.T
    turns = [pin.log3(first @ pin.XYZQUATToSE3(q[:7]).rotation) for q in track.q[::10]]
    assert 0.5 * limit < np.linalg.norm(turns, axis=1).max() <= limit
    assert track.position_error[-1] < 5e-3


def test_a_target_is_reached_with_momentum(planar: ffsms.SpaceManipulator) -> None:
    q0 = planar.configuration([0.3, 0.6, 0.5])
    target = planar.at(q0).end_effector_pose.translation + np.array([-0.2, 0.15, 0.0])
    momentum = planar.at(q0, 0.01 * np.eye(9)[5]).momentum
    reference = opt.StepPlanner(planar, 0.02, momentum=momentum).track(target, 6.0)
    law = ComputedTorque(planar, 100.0, 20.0)
    tracking = simulate(planar, reference, law, dt=5e-3, q0=q0, conditions=Conditions(guards=None))
    np.testing.assert_allclose(tracking.momentum[-1], momentum, atol=1e-9)
    assert tracking.position_error[-1] < 2e-3
    assert reference.note == ""
