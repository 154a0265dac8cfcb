"""The direction of a step: angle and side of the cone, the speed schedule, and reference weights."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, strategies as st
from step_parts import desired_motion

import ffsms_pin as ffsms
from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.step.state import REFERENCES, StepState


@given(st.integers(0, 2**32 - 1), st.floats(-1.0, 1.0))
def test_the_direction_has_the_requested_angle_and_side(seed: int, cosine: float) -> None:
    rng, sms = np.random.default_rng(seed), ffsms.load("planar_3r")
    displacement, hint = rng.normal(size=3), rng.normal(size=3)
    towards = displacement / np.linalg.norm(displacement)
    step = StepState(sms, sms.configuration([0.4, 0.7, -0.5]), np.zeros(3), 0.01, 5.0)
    motion = desired_motion(step, step.pose.translation + displacement, cosine, hint)
    across = hint - (hint @ towards) * towards
    np.testing.assert_allclose(motion.side, across / np.linalg.norm(across), atol=1e-12)
    assert np.linalg.norm(motion.direction) == pytest.approx(1.0)
    assert motion.direction @ towards == pytest.approx(cosine, abs=1e-12)
    assert motion.side @ hint >= 0.0


def test_a_side_exists_without_a_usable_hint(planar: ffsms.SpaceManipulator) -> None:
    towards = np.array([0.0, 0.0, 1.0])
    step = StepState(planar, planar.configuration([0.4, 0.7, -0.5]), np.zeros(3), 0.01, 5.0)
    for hint in (np.zeros(3), 5.0 * towards):
        side = desired_motion(step, step.pose.translation + towards, 0.6, hint).side
        assert np.linalg.norm(side) == pytest.approx(1.0)
        assert abs(side @ towards) < 1e-12


def test_the_speed_schedule_ends_the_path_at_the_deadline() -> None:
    """The remaining path is proportional to (time left)^2.5."""
    dt, remaining, speed = 0.01, 1.0, kernel.ARRIVAL_POWER / 12.0
    for k in range(1200):
        next_speed = kernel.reference_speed(remaining, speed, 12.0 - k * dt, dt)
        remaining, speed = remaining - 0.5 * dt * (speed + next_speed), next_speed
        if k == 1079:
            assert remaining == pytest.approx(0.1**2.5, rel=0.05)
    assert 0.0 <= remaining < 1e-5
    assert 0.0 <= speed < 1e-3


def test_the_side_of_the_cone_is_the_requested_side(planar: ffsms.SpaceManipulator) -> None:
    q, target = planar.configuration([0.4, 0.7, -0.5]), np.array([0.45, 0.75, 0.0])
    step = StepState(planar, q, np.array([0.1, -0.2, 0.1]), 0.01, 5.0)
    towards = target - step.pose.translation
    towards /= np.linalg.norm(towards)
    default = desired_motion(step, target, 0.6, np.zeros(3))
    for side in (default.side, -default.side):
        motion = desired_motion(step, target, 0.6, side)
        np.testing.assert_allclose(motion.side, side, atol=1e-12)
        np.testing.assert_allclose(motion.towards, towards, atol=1e-12)
        assert motion.direction @ towards == pytest.approx(0.6)
        assert motion.direction @ side > 0.0
    # The default side is that of the end effector's velocity.
    assert default.side @ (step.J_star[:3] @ step.rates) > 0.0
    arrived = desired_motion(step, step.pose.translation.copy(), 0.6, default.side)
    assert arrived.speed == 0.0
    np.testing.assert_array_equal(arrived.direction, np.zeros(3))
    np.testing.assert_array_equal(arrived.side, default.side)


def test_the_requested_speed_is_within_the_joint_accelerations(planar: ffsms.SpaceManipulator) -> None:
    q, target = planar.configuration([0.4, 0.7, -0.5]), np.array([0.45, 0.75, 0.0])
    step = StepState(planar, q, np.zeros(3), 0.01, 0.5)
    motion = desired_motion(step, target, 1.0, np.zeros(3))
    largest = 0.01 * np.abs(motion.direction @ step.J_star[:3]) @ planar.limits.acceleration
    assert motion.speed == pytest.approx(largest)


def test_the_angular_velocity_points_to_the_target_attitude() -> None:
    sms = ffsms.load("satellite_xarm7")
    q = sms.configuration([0.2, -0.5, 0.3, 1.2, 0.2, 0.9, 0.1])
    step = StepState(sms, q, np.zeros(7), 0.01, 5.0)
    rotation_vector = np.array([0.1, -0.2, 0.3])

    def target_spin(rotation: FloatArray) -> FloatArray:
        spin = desired_motion(step, step.tip, 1.0, np.zeros(3), rotation).angular_velocity
        assert spin is not None
        return spin

    spin = target_spin(pin.exp3(rotation_vector) @ step.pose.rotation)
    np.testing.assert_allclose(
        spin / np.linalg.norm(spin), rotation_vector / np.linalg.norm(rotation_vector), atol=1e-9
    )
    np.testing.assert_array_equal(target_spin(step.pose.rotation.copy()), np.zeros(3))


def test_weights_of_the_references_agree_with_the_state() -> None:
    sms = ffsms.load("satellite_xarm7")
    q = sms.configuration([0.2, -0.5, 0.3, 1.2, 0.2, 0.9, 0.1])
    step, state = StepState(sms, q, np.zeros(7), 0.01, 5.0), sms.at(q)
    weights = {"least-disturbance": state.C_bm[3:].T @ state.C_bm[3:], "minimum-effort": state.H_q}
    for name, weight in weights.items():
        weight_of = REFERENCES[name]
        assert weight_of is not None
        np.testing.assert_allclose(weight_of(step), 7.0 * weight / np.trace(weight), atol=1e-10)
    assert [name for name, weight_of in REFERENCES.items() if weight_of is None] == ["step", "resolved-rate"]
