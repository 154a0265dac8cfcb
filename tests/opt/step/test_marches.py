"""Marches of steps: they arrive, and every limit holds with its rows and breaks without."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin
import pytest
from clearances_at import At, Points
from step_parts import TARGET, make_stepper, missed, path, plan_stepwise

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.checks import FloatArray
from ffsms_pin.geometry.bodies import clearance_stack
from ffsms_pin.opt.step.stepwise import sides_of


@pytest.mark.parametrize("name", ["planar_3r", "satellite_panda", "satellite_xarm7"])
def test_marches_arrive_within_all_limits(name: str) -> None:
    """A long reach of the planar arm, and reaches of similar size with arms of seven joints."""
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
    done = plan_stepwise(stepper, q0, target, duration)
    assert done.note == ""
    q = path(sms, q0, done.rates, dt)
    assert missed(sms, q[-1], target) < 1e-3
    joints = np.array([sms.layout.positions(row) for row in q])
    accelerations = np.diff(done.rates, axis=0) / dt
    assert (joints >= sms.limits.lower).all()
    assert (joints <= sms.limits.upper).all()
    assert (np.abs(done.rates) <= sms.limits.velocity).all()
    assert (np.abs(accelerations) <= sms.limits.acceleration * (1.0 + 1e-12)).all()
    assert min(Points(sms).values(row).min() for row in q) >= 0.01 - 1e-9


def loosened(sms: ffsms.SpaceManipulator, **changes: FloatArray) -> ffsms.SpaceManipulator:
    return sms.with_limits(dataclasses.replace(sms.limits, **changes))


@pytest.mark.parametrize("limit", ["velocity", "acceleration", "position"])
def test_a_joint_limit_holds_with_its_rows_and_breaks_without(
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
    if limit == "position":  # where the arm would be with its first joint 24 degrees beyond the limit
        beyond = planar.configuration(np.deg2rad([105.0, 30.0, -10.0]))
        target = planar.at(beyond).end_effector_pose.translation

    def worst(sms: ffsms.SpaceManipulator) -> FloatArray:
        done = plan_stepwise(make_stepper(sms, collision="off"), start, target, duration)
        joints = np.array([sms.layout.positions(q) for q in path(sms, start, done.rates, 0.01)])
        values = {"velocity": done.rates, "acceleration": np.diff(done.rates, axis=0) / 0.01}
        return np.asarray(np.abs({**values, "position": joints}[limit]).max(axis=0))

    assert (worst(planar) <= bound + 1e-9).all()
    assert (worst(loosened(planar, **changes)) > bound + 1e-3).any()


@pytest.mark.parametrize("case", ["into the base", "onto itself"])
@pytest.mark.parametrize("mode", ["points", "shapes"])
def test_clearances_are_kept_with_their_rows_and_lost_without(
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
        done = plan_stepwise(make_stepper(planar, 0.02, collision=collision), start, target, 6.0)
        return min(float(model.values(q).min()) for q in path(planar, start, done.rates, 0.02))

    assert least(mode) >= 0.01 - 1e-6
    assert least("off") < 0.01


@pytest.mark.parametrize("name", ["planar_3r", "satellite_xarm7"])
def test_momentum_is_reckoned_with(name: str) -> None:
    sms, dt = ffsms.load(name), 0.02
    planar = sms.n == 3
    base = None if planar else pin.SE3(pin.rpy.rpyToMatrix(0.4, -0.7, 1.1), np.array([0.5, -0.2, 0.3]))
    q0 = sms.configuration([0.3, 0.6, 0.5] if planar else [0.2, -0.5, 0.3, 1.2, 0.2, 0.9, 0.1], base)
    state = sms.at(q0)
    spin = np.array([0.0, 0.0, 0.018]) if planar else np.array([0.008, -0.01, 0.012])
    drift = np.array([0.006, -0.005, 0.0 if planar else 0.004])
    momentum = np.concatenate([state.H[0, 0] * drift, state.H[3:6, 3:6] @ spin])
    way = np.array([-0.2, 0.15, 0.0]) if planar else state.base_pose.rotation @ np.array([-0.1, 0.2, 0.15])
    target = state.end_effector_pose.translation + way
    for known, near, far in ((momentum, 0.0, 2e-3), (None, 0.03, 1.0)):
        stepper = make_stepper(sms, dt, momentum=known)
        stepper.reset(sides_of(opt.Problem(sms, q0, target))[0])
        done = plan_stepwise(stepper, q0, target, 8.0)
        # One that knows nothing of the momentum misses by centimetres.
        assert near <= missed(sms, path(sms, q0, done.rates, dt, momentum)[-1], target) < far


def test_a_pose_is_reached_with_momentum() -> None:
    sms, dt = ffsms.load("satellite_xarm7"), 0.02
    q0 = sms.configuration([0.2, -0.5, 0.3, 1.2, 0.2, 0.9, 0.1])
    pose = sms.at(q0).end_effector_pose.copy()
    pose.translation = pose.translation + np.array([-0.1, 0.15, 0.05])
    pose.rotation = pose.rotation @ pin.rpy.rpyToMatrix(0.2, -0.1, 0.3)
    momentum = np.array([0.5, -0.4, 0.3, 0.2, -0.3, 0.3])
    left = []
    for rotation in (pose.rotation, None):
        done = plan_stepwise(make_stepper(sms, dt, momentum=momentum), q0, pose.translation, 8.0, rotation)
        q = path(sms, q0, done.rates, dt, momentum)[-1]
        assert missed(sms, q, pose.translation) < 2e-3
        left.append(float(np.linalg.norm(pin.log3(pose.rotation.T @ sms.at(q).end_effector_pose.rotation))))
    assert left[0] < 5e-3
    assert left[1] > 0.05
