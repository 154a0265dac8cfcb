"""Steps: cost, references, copies and arguments."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from step_parts import TARGET, StepJoints, distance_to, make_stepper, path, plan_stepwise, random_state

import ffsms_pin as ffsms
from ffsms_pin.errors import InvalidValue
from ffsms_pin.opt.costs import step_cost
from ffsms_pin.opt.limits.alpha_box import AlphaBox
from ffsms_pin.opt.step.state import StepState, rate_bounds
from ffsms_pin.opt.step.stepper import Stepper, StepWeights


@pytest.mark.parametrize("kappa", [1.0, 10.0, 1000.0])
def test_the_cost_of_an_unconstrained_step_is_zero(planar: ffsms.SpaceManipulator, kappa: float) -> None:
    q, rates, stepper = planar.configuration([0.4, 0.7, -0.5]), np.zeros(3), make_stepper(planar, kappa=kappa)
    for k in range(50):  # acceleration limits are active at first
        rates = stepper.step(q, rates, TARGET, 12.0 - 0.01 * k).joint_rates
    step = stepper.step(q, rates, TARGET, 11.5)
    # With a steep cost the weight of the speed has a small effect.
    assert step.cost < (1e-6 if kappa == 1.0 else 1e-9)
    assert step.cost == pytest.approx(step_cost(step.cos_theta, step.entropy, kappa))
    state = planar.at(q)
    towards = TARGET - state.end_effector_pose.translation
    assert step.cos_theta == pytest.approx(state.coupling.assistance(step.joint_rates, towards), abs=1e-9)
    assert step.entropy == pytest.approx(state.coupling.entropy, abs=1e-12)
    np.testing.assert_allclose(
        StepState(planar, q, rates, 0.01, 1.0).V @ step.alpha, step.joint_rates, atol=1e-12
    )


def test_an_arm_at_its_target_stays(planar: ffsms.SpaceManipulator) -> None:
    q = planar.configuration([0.4, 0.7, -0.5])
    here = planar.at(q).end_effector_pose.translation
    step = make_stepper(planar).step(q, np.zeros(3), here, 1.0)
    np.testing.assert_allclose(step.joint_rates, 0.0, atol=1e-6)
    assert step.cos_theta == 0.0


@pytest.mark.parametrize("reference", ["resolved-rate", "least-disturbance", "minimum-effort"])
def test_classical_references_move_straight(reference: str) -> None:
    sms = ffsms.load("satellite_xarm7")
    q0 = sms.configuration([0.2, -0.5, 0.3, 1.2, 0.2, 0.9, 0.1])
    start = sms.at(q0).end_effector_pose.translation
    displacement = np.array([-0.1, 0.2, 0.15])
    stepper = make_stepper(sms, 0.02, reference=reference)
    q = path(sms, q0, plan_stepwise(stepper, q0, start + displacement, 6.0).rates, 0.02)
    places = np.array([sms.at(row).end_effector_pose.translation for row in q[::10]]) - start
    across = places - np.outer(places @ displacement, displacement) / (displacement @ displacement)
    assert np.abs(across).max() < 2e-3
    assert distance_to(sms, q[-1], start + displacement) < 1e-3


def test_least_disturbance_turns_the_base_less() -> None:
    sms = ffsms.load("satellite_xarm7")
    q0 = sms.configuration([0.2, -0.5, 0.3, 1.2, 0.2, 0.9, 0.1])
    target = sms.at(q0).end_effector_pose.translation + np.array([-0.1, 0.2, 0.15])
    rotation = {}
    for reference in ("resolved-rate", "least-disturbance"):
        q = path(
            sms, q0, plan_stepwise(make_stepper(sms, 0.02, reference=reference), q0, target, 6.0).rates, 0.02
        )
        rotation[reference] = np.linalg.norm(pin.log3(pin.XYZQUATToSE3(q[-1, :7]).rotation))
    assert rotation["least-disturbance"] < 0.85 * rotation["resolved-rate"]


def test_preferred_rates_are_clipped_to_the_limits(planar: ffsms.SpaceManipulator) -> None:
    q, rates = random_state(planar, 3)
    stepper = make_stepper(planar, collision="off")
    lower, upper = rate_bounds(planar.layout.positions(q), rates, planar.limits, stepper.dt)
    inside = 0.3 * lower + 0.7 * upper
    step = stepper.advance(q, rates, TARGET, 5.0, prefer=inside)
    np.testing.assert_allclose(step.joint_rates, inside, rtol=0.0, atol=1e-9)
    outside = np.array([5.0, -5.0, inside[2]])
    step = stepper.advance(q, rates, TARGET, 5.0, prefer=outside)
    np.testing.assert_allclose(step.joint_rates, np.clip(outside, lower, upper), rtol=0.0, atol=1e-9)
    # The next step has its usual objective.
    np.testing.assert_allclose(
        stepper.step(q, rates, TARGET, 5.0).joint_rates,
        make_stepper(planar, collision="off").step(q, rates, TARGET, 5.0).joint_rates,
        rtol=0.0,
        atol=1e-12,
    )


def test_a_stepper_like_another_keeps_its_settings(planar: ffsms.SpaceManipulator) -> None:
    weights, limits = StepWeights(change=1e-4), [StepJoints(), AlphaBox()]
    stepper = Stepper(planar, 0.02, 5.0, limits, (), weights, "resolved-rate", np.ones(6))
    copied = stepper.like()
    assert (copied.sms, copied.dt, copied.kappa, copied.weights) == (planar, 0.02, 5.0, weights)
    assert [type(limit) for limit in copied.limits] == [StepJoints, AlphaBox]
    assert copied.momentum is not None
    assert copied.momentum.tolist() == [1.0] * 6
    assert copied.reference == "resolved-rate"
    assert stepper.like(sms=ffsms.load("satellite_panda")).sms.n == 7


def test_a_changed_step_length_takes_effect(planar: ffsms.SpaceManipulator) -> None:
    q, rates = random_state(planar, 2)
    stepper = make_stepper(planar, 0.01)
    stepper.dt = 0.05
    expected = make_stepper(planar, 0.05).step(q, rates, TARGET, 5.0)
    np.testing.assert_array_equal(stepper.step(q, rates, TARGET, 5.0).joint_rates, expected.joint_rates)


def test_a_copied_stepper_continues_like_the_original(planar: ffsms.SpaceManipulator) -> None:
    q, rates = random_state(planar, 3)
    stepper = make_stepper(planar)
    stepper.reset([0.0, -1.0, 0.0])
    stepper.step(q, rates, TARGET, 5.0)
    copies = [copy.deepcopy(stepper), pickle.loads(pickle.dumps(stepper))]
    other, later = random_state(planar, 4)
    expected = stepper.step(other, later, TARGET, 4.0)
    for copied in copies:
        np.testing.assert_array_equal(
            copied.step(other, later, TARGET, 4.0).joint_rates, expected.joint_rates
        )
        built = zip(copied.build(q, rates, TARGET, 5.0), stepper.build(q, rates, TARGET, 5.0), strict=True)
        assert all(np.array_equal(a, b) for a, b in built)


def test_a_step_is_deterministic(planar: ffsms.SpaceManipulator) -> None:
    q, rates = random_state(planar, 3)
    first, second = (make_stepper(planar).step(q, rates, TARGET, 5.0) for _ in range(2))
    np.testing.assert_array_equal(first.joint_rates, second.joint_rates)


def test_arguments_of_any_kind_give_the_same_step(planar: ffsms.SpaceManipulator) -> None:
    q, rates = random_state(planar, 3)
    expected = make_stepper(planar).step(q, rates, TARGET, 5.0).joint_rates
    strided = np.zeros((planar.n, 2))
    strided[:, 0] = rates
    pose = pin.SE3(planar.at(q).end_effector_pose.rotation, TARGET)
    for arguments in (
        (q.tolist(), rates.tolist(), TARGET.tolist(), 5),
        (q, strided[:, 0], TARGET, np.float64(5.0)),
    ):
        joint_rates = make_stepper(planar).step(*arguments).joint_rates
        np.testing.assert_allclose(joint_rates, expected, rtol=0.0, atol=1e-12)
    assert make_stepper(planar).step(q, rates, pose, 5.0).solved


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"q": np.zeros(9)}, "q"),
        ({"q": np.zeros(10)}, "quaternion"),
        ({"joint_rates": [0.0, np.nan, 0.0]}, "joint_rates"),
        ({"target": [1.0, 2.0]}, "target"),
        ({"time_left": "soon"}, "time_left"),
    ],
)
def test_wrong_arguments_are_named(
    planar: ffsms.SpaceManipulator, change: dict[str, object], name: str
) -> None:
    arguments: dict[str, Any] = {"q": planar.configuration([0, 0, 0]), "joint_rates": np.zeros(3)}
    arguments |= {"target": TARGET, "time_left": 1.0} | change
    for call in (make_stepper(planar).step, make_stepper(planar).build):
        with pytest.raises(InvalidValue, match=name):
            call(**arguments)


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"dt": 0.0}, "dt"),
        ({"kappa": -1.0}, "kappa"),
        ({"reference": "fast"}, "reference"),
        ({"momentum": [1.0]}, "momentum"),
    ],
)
def test_wrong_settings_are_named(planar: ffsms.SpaceManipulator, change: dict[str, Any], name: str) -> None:
    settings: dict[str, Any] = {"dt": 0.01, "kappa": 10.0, "limits": []} | change
    with pytest.raises(InvalidValue, match=name):
        Stepper(planar, **settings)


def test_bounded_rates_are_within_the_accelerations(planar: ffsms.SpaceManipulator) -> None:
    stepper, joints, requested = (
        make_stepper(planar),
        np.array([0.3, 0.5, -0.4]),
        np.array([9.0, -9.0, 0.001]),
    )
    bounded = stepper.bounded(joints, np.zeros(3), requested)
    largest = planar.limits.acceleration * stepper.dt
    np.testing.assert_allclose(bounded, [largest[0], -largest[1], 0.001], atol=1e-12)
