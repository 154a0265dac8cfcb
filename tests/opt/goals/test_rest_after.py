"""Meeting a client with the initial momentum that leaves both bodies at rest after capture."""

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import ffsms_pin as ffsms
from ffsms_pin import opt
from ffsms_pin.client import after_capture, rest_momentum
from ffsms_pin.opt.goals.goal import Changed

DURATION = 12.0


@pytest.fixture(scope="module")
def case() -> tuple[ffsms.SpaceManipulator, np.ndarray, ffsms.Client, pin.SE3]:
    """A robot, a start, and a client that flies by slowly and tumbles."""
    sms = ffsms.load("satellite_panda")
    q0 = sms.configuration([0.0, -0.5, 0.0, -2.0, 0.0, 1.5, 0.8])
    tip = sms.at(q0).end_effector_pose
    grasp = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.3]))
    there = tip * pin.SE3(np.eye(3), np.array([0.05, 0.1, 0.25]))
    twist = np.array([0.004, -0.003, 0.002, 0.02, -0.03, 0.02])
    then = ffsms.Client(80.0, [6.0, 9.0, 11.0], there * grasp.inverse(), twist)
    now = ffsms.Client(80.0, [6.0, 9.0, 11.0], then.pose(-DURATION), then.twist(-DURATION))
    return sms, q0, now, grasp


def test_rest_after_sets_the_momentum_that_leaves_both_at_rest(case: Any) -> None:
    sms, q0, client, grasp = case
    plan = opt.plan(sms, q0, opt.Meet(client, grasp, rest_after=True), DURATION, 0.02, time_limit=1e-9)
    assert plan.reached
    assert plan.note == ""
    com = pin.centerOfMass(sms.model, sms.model.createData(), q0)
    np.testing.assert_allclose(plan.momentum, rest_momentum(client, com), rtol=1e-12)
    after = after_capture(sms, plan.q[-1], plan.v[-1], client, DURATION)
    assert np.linalg.norm(after.rest_rate()) < 1e-6
    assert np.linalg.norm(after.momentum[:3]) < 1e-9


def test_another_momentum_is_reported(case: Any) -> None:
    sms, q0, client, grasp = case
    momentum = [0.1, 0.0, 0.0, 0.0, 0.0, 0.0]
    plan = opt.plan(
        sms, q0, opt.Meet(client, grasp, rest_after=True), DURATION, 0.05, momentum=momentum, time_limit=1e-9
    )
    assert "leaves both at rest" in plan.note
    np.testing.assert_array_equal(plan.momentum, momentum)
    after = after_capture(sms, plan.q[-1], plan.v[-1], client, DURATION)
    assert np.linalg.norm(after.rest_rate()) > 1e-3


def test_without_rest_after_the_momentum_is_zero(case: Any) -> None:
    sms, q0, client, grasp = case
    assert opt.Problem(sms, q0, opt.Meet(client, grasp), DURATION).momentum is None


def test_a_time_shifted_goal_keeps_its_approach(case: Any) -> None:
    _, _, client, grasp = case
    goal = opt.Meet(client, grasp)
    later = Changed(goal, time_offset=4.0)
    assert later.exact
    assert not later.coupled
    first, second = goal.approach(DURATION), later.approach(DURATION - 4.0)
    assert len(first) == len(second) > 1
    for (t, place), (then, other) in zip(first, second, strict=True):
        assert then == pytest.approx(t - 4.0)
        np.testing.assert_allclose(other.position, place.position)
    half = Changed(goal, time_offset=10.5).approach(DURATION - 10.5)  # a part of the approach is over
    assert 0 < len(half) < len(first)
    assert Changed(goal, time_offset=11.9).approach(0.1) == []
