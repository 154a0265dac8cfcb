"""Rollouts of steps: arrival, and limits with and without their rows."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin
import pytest
from clearances_at import At, Points
from step_parts import TARGET, distance_to, make_stepper, path, plan_stepwise

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.geometry.bodies import clearance_stack
from ffsms_pin.opt.step.stepwise import sides_of


@pytest.mark.parametrize("name", ["planar_3r", "satellite_panda", "satellite_xarm7"])
def test_rollouts_arrive_within_all_limits(name: str) -> None:
    """The moves are long for the planar arm and of similar size for arms of seven joints."""
    sms, dt = ffsms.load(name), 0.02
    middle, half = 0.5 * (sms.limits.upper + sms.limits.lower), 0.5 * (sms.limits.upper - sms.limits.lower)
    if name == "planar_3r":
        q0, target, duration = sms.configuration(np.deg2rad([1.0, 1.0, 1.0])), TARGET, 12.0
    else:
        q0, duration = sms.configuration(middle), 8.0
        goal = middle + 0.2 * half * np.random.default_rng(1).uniform(-1.0, 1.0, sms.n)
        target = sms.at(sms.configuration(goal)).end_effector_pose.translation.copy()
    stepper = make_stepper(sms, dt)
    stepper.reset(sides_of(opt.Problem(sms, q0, target))[0])
    result = plan_stepwise(stepper, q0, target, duration)
    assert result.note == ""
    q = path(sms, q0, result.rates, dt)
    assert distance_to(sms, q[-1], target) < 1e-3
    joints = np.array([sms.layout.positions(row) for row in q])
    accelerations = np.diff(result.rates, axis=0) / dt
    assert (joints >= sms.limits.lower).all()
    assert (joints <= sms.limits.upper).all()
    assert (np.abs(result.rates) <= sms.limits.velocity).all()
    assert (np.abs(accelerations) <= sms.limits.acceleration * (1.0 + 1e-12)).all()
    assert min(Points(sms).values(row).min() for row in q) >= 0.01 - 1e-9


def with_limits(sms: ffsms.SpaceManipulator, **changes: FloatArray) -> ffsms.SpaceManipulator:
    return sms.with_limits(dataclasses.replace(sms.limits, **changes))


@pytest.mark.parametrize("limit", ["velocity", "acceleration", "position"])
def test_joint_limits_hold_with_their_rows_and_are_violated_without(
    planar: ffsms.SpaceManipulator, limit: str
) -> None:
    infinite = np.full(3, np.inf)
    changes = {
        "velocity": {"velocity": infinite},
        "acceleration": {"acceleration": 100.0 * planar.limits.acceleration},
        "position": {"lower": -infinite, "upper": infinite},
    }[limit]
    bound = planar.limits.upper if limit == "position" else getattr(planar.limits, limit)
    start = planar.configuration(np.deg2rad([60.0, 30.0, -10.0]))
    target, duration = TARGET, 4.0
    if limit == "position":  # reached with the first joint 24 degrees beyond its limit
        beyond_limit = planar.configuration(np.deg2rad([105.0, 30.0, -10.0]))
        target = planar.at(beyond_limit).end_effector_pose.translation

    def worst(sms: ffsms.SpaceManipulator) -> FloatArray:
        result = plan_stepwise(make_stepper(sms, collision="off"), start, target, duration)
        joints = np.array([sms.layout.positions(q) for q in path(sms, start, result.rates, 0.01)])
        values = {"velocity": result.rates, "acceleration": np.diff(result.rates, axis=0) / 0.01}
        return np.asarray(np.abs({**values, "position": joints}[limit]).max(axis=0))

    assert (worst(planar) <= bound + 1e-9).all()
    assert (worst(with_limits(planar, **changes)) > bound + 1e-3).any()


@pytest.mark.parametrize("case", ["into the base", "onto itself"])
@pytest.mark.parametrize("mode", ["points", "shapes"])
def test_clearances_hold_with_their_rows_and_are_violated_without(
    planar: ffsms.SpaceManipulator, case: str, mode: str
) -> None:
    degrees, goal = (
        ([75.0, 60.0, 20.0], [0.1, 0.15, 0.0])
        if case == "into the base"
        else (
            [0.0, 70.0, 70.0],
            [0.232, 0.0, 0.0],
        )
    )
    start = planar.configuration(np.deg2rad(degrees))
    target = planar.at(start).base_pose.act(np.array(goal))
    stack = clearance_stack(planar, mode)
    assert stack is not None
    model = At(stack)

    def least(collision: str) -> float:
        result = plan_stepwise(make_stepper(planar, 0.02, collision=collision), start, target, 6.0)
        return min(float(model.values(q).min()) for q in path(planar, start, result.rates, 0.02))

    assert least(mode) >= 0.01 - 1e-6
    assert least("off") < 0.01


@pytest.mark.parametrize("name", ["planar_3r", "satellite_xarm7"])
def test_steps_with_momentum_reach_the_target(name: str) -> None:
    sms, dt = ffsms.load(name), 0.02
    planar = sms.n == 3
    base = None if planar else pin.SE3(pin.rpy.rpyToMatrix(0.4, -0.7, 1.1), np.array([0.5, -0.2, 0.3]))
    q0 = sms.configuration([0.3, 0.6, 0.5] if planar else [0.2, -0.5, 0.3, 1.2, 0.2, 0.9, 0.1], base)
    state = sms.at(q0)
    spin = np.array([0.0, 0.0, 0.018]) if planar else np.array([0.008, -0.01, 0.012])
    drift = np.array([0.006, -0.005, 0.0 if planar else 0.004])
    momentum = np.concatenate([state.H[0, 0] * drift, state.H[3:6, 3:6] @ spin])
    displacement = (
        np.array([-0.2, 0.15, 0.0]) if planar else state.base_pose.rotation @ np.array([-0.1, 0.2, 0.15])
    )
    target = state.end_effector_pose.translation + displacement
    for used_momentum, near, far in ((momentum, 0.0, 2e-3), (None, 0.03, 1.0)):
        stepper = make_stepper(sms, dt, momentum=used_momentum)
        stepper.reset(sides_of(opt.Problem(sms, q0, target))[0])
        result = plan_stepwise(stepper, q0, target, 8.0)
        # A stepper without the momentum misses by centimetres.
        assert near <= distance_to(sms, path(sms, q0, result.rates, dt, momentum)[-1], target) < far


def test_a_pose_is_reached_with_momentum() -> None:
    sms, dt = ffsms.load("satellite_xarm7"), 0.02
    q0 = sms.configuration([0.2, -0.5, 0.3, 1.2, 0.2, 0.9, 0.1])
    pose = sms.at(q0).end_effector_pose.copy()
    pose.translation = pose.translation + np.array([-0.1, 0.15, 0.05])
    pose.rotation = pose.rotation @ pin.rpy.rpyToMatrix(0.2, -0.1, 0.3)
    momentum = np.array([0.5, -0.4, 0.3, 0.2, -0.3, 0.3])
    angles = []
    for rotation in (pose.rotation, None):
        result = plan_stepwise(make_stepper(sms, dt, momentum=momentum), q0, pose.translation, 8.0, rotation)
        q = path(sms, q0, result.rates, dt, momentum)[-1]
        assert distance_to(sms, q, pose.translation) < 2e-3
        angles.append(float(np.linalg.norm(pin.log3(pose.rotation.T @ sms.at(q).end_effector_pose.rotation))))
    assert angles[0] < 5e-3
    assert angles[1] > 0.05
