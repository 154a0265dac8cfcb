"""Friction estimated by computed torque, in closed loop and compared with the simulated friction."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import ffsms_pin as ffsms
from ffsms_pin import opt, simulation
from ffsms_pin.control import ComputedTorque, Coordinated, QuaternionFeedback
from ffsms_pin.control.friction_observer import FrictionObserver

COULOMB = np.array([0.08, 0.05, 0.03])


@pytest.fixture(scope="module")
def plan() -> opt.Trajectory:
    sms = ffsms.load("planar_3r")
    return opt.plan(sms, sms.configuration(np.radians([10, 40, -30])), [0.7, 0.35, 0.0], 8.0, 0.05)


def follow(plan: opt.Trajectory, adaptive: bool, **conditions: Any) -> ffsms.Tracking:
    assert plan.problem is not None
    law = ComputedTorque(plan.problem.sms, adaptive=adaptive)
    return ffsms.simulate(plan.problem.sms, plan, law, dt=5e-3, **conditions)


def test_estimated_friction_is_compensated(plan: opt.Trajectory) -> None:
    friction = simulation.JointFriction(coulomb=COULOMB)
    without, learnt = (follow(plan, adaptive, friction=friction) for adaptive in (False, True))
    assert not without.arrived
    assert learnt.arrived
    assert np.abs(learnt.joint_error[-1]).max() < 1e-3
    assert np.abs(without.joint_error[-1]).max() > 0.05


class Steady:
    """A reference with constant joint rates."""

    duration, target = 4.0, np.zeros(3)

    def __init__(self, q0: NDArray[np.float64], rates: NDArray[np.float64]) -> None:
        self.q, self._rates = q0[None], rates

    def sample(self, t: float) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        return self.q[0, 7:] + t * self._rates, self._rates, np.zeros(3)


def test_the_estimate_is_the_friction_that_acts() -> None:
    """At constant rates the drives give the model's torque and the friction."""
    sms = ffsms.load("planar_3r")
    reference = Steady(sms.configuration([0.1, 0.4, -0.3]), np.array([0.1, -0.12, 0.15]))
    friction = simulation.JointFriction(coulomb=COULOMB)
    tracking = ffsms.simulate(
        sms, reference, ComputedTorque(sms), dt=5e-3, conditions=ffsms.Conditions(friction=friction)
    )
    observer = FrictionObserver(sms, 5e-3, np.full(3, np.inf))
    for k, tau in enumerate(tracking.tau):
        observer.update(sms, tracking.q[k], tracking.v[k])
        observer.acted(tracking.q[k], tracking.v[k], tau)
    np.testing.assert_allclose(observer.friction, COULOMB, rtol=0.02)


def test_the_estimate_grows_slowly_with_the_samples() -> None:
    """One sample explains any torque, so its full estimate would accelerate a light wrist."""
    sms, rates = ffsms.load("planar_3r"), np.array([0.1, -0.12, 0.15])
    observer = FrictionObserver(sms, 5e-3, np.full(3, np.inf))
    q, shares = sms.configuration([0.1, 0.4, -0.3]), []
    v = sms.velocity(q, rates)
    for k in range(200):
        observer.update(sms, q, v)
        observer.acted(q, v, COULOMB * np.sign(rates))
        shares.append(float((observer.friction / COULOMB).max()))
        assert k > 10 or shares[-1] < 0.3
    assert 0.8 < shares[-1] < 1.2


def test_nothing_is_estimated_without_friction(plan: opt.Trajectory) -> None:
    without, learnt = (follow(plan, adaptive) for adaptive in (False, True))
    np.testing.assert_allclose(learnt.q, without.q, atol=1e-6)


def test_an_unknown_payload_is_not_taken_for_friction() -> None:
    sms = ffsms.load("satellite_ur5")
    q0 = sms.home()
    goal = sms.at(q0).end_effector_pose.translation + np.array([-0.1, 0.15, 0.1])
    plan = opt.plan(sms, q0, goal, 6.0, 0.05)
    payload = simulation.Capture(0.0, 10.0, 0.1 * np.eye(3))
    without, learnt = (follow(plan, adaptive, events=[payload]) for adaptive in (False, True))
    errors = [float(np.abs(run.joint_error).max()) for run in (without, learnt)]
    assert errors[1] < 1.2 * errors[0] + 0.01


def test_a_single_torque_contains_no_friction_estimate() -> None:
    sms = ffsms.load("planar_3r")
    law, q, v = ComputedTorque(sms), sms.configuration([0.1, 0.2, 0.3]), np.zeros(9)
    first = law.torque(q, v, [0.2, 0.2, 0.2], np.zeros(3), np.zeros(3))
    np.testing.assert_array_equal(law.torque(q, v, [0.2, 0.2, 0.2], np.zeros(3), np.zeros(3)), first)
    law.reset(1e-3)
    np.testing.assert_array_equal(law.torque(q, v, [0.2, 0.2, 0.2], np.zeros(3), np.zeros(3)), first)


PYRAMID = [[1, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]]


@pytest.fixture(scope="module")
def held() -> opt.Trajectory:
    """A plan with the base's attitude held by wheels."""
    wheels = ffsms.ReactionWheels(PYRAMID, 0.001364, torque=5.0, momentum=50.0)
    sms = ffsms.load("planar_3r").with_actuators(wheels=wheels)
    q0 = sms.configuration(np.radians([10, 40, -30]))
    return opt.plan(sms, q0, [0.7, 0.35, 0.0], 8.0, 0.05, mode="rotation-floating")


def follow_held(plan: opt.Trajectory, law: str, adaptive: bool, **conditions: Any) -> ffsms.Tracking:
    assert plan.problem is not None
    sms = plan.problem.sms
    joints = (Coordinated if law == "coordinated" else ComputedTorque)(sms, adaptive=adaptive)
    base = joints if isinstance(joints, Coordinated) else QuaternionFeedback(sms)
    return ffsms.simulate(sms, plan, joints, 5e-3, base_controller=base, **conditions)


@pytest.mark.parametrize(
    "law",
    ["coordinated", pytest.param("quaternion feedback", marks=[pytest.mark.slow, pytest.mark.long])],
)
def test_estimated_friction_is_compensated_with_the_base_held_by_wheels(
    held: opt.Trajectory, law: str
) -> None:
    friction = simulation.JointFriction(coulomb=COULOMB)
    without, learnt = (follow_held(held, law, adaptive, friction=friction) for adaptive in (False, True))
    assert not without.arrived
    assert learnt.arrived
    assert learnt.position_error[-1] < 2e-3
    assert np.abs(learnt.joint_error[-1]).max() < 1e-3
    assert np.degrees(learnt.base_rotation.max()) < 0.1  # torques against friction are no reaction


@pytest.mark.parametrize("law", ["quaternion feedback", "coordinated"])
def test_the_reaction_of_wheels_is_not_taken_for_friction(held: opt.Trajectory, law: str) -> None:
    without, learnt = (follow_held(held, law, adaptive) for adaptive in (False, True))
    np.testing.assert_allclose(learnt.q, without.q, atol=1e-6)
