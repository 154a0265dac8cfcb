"""Where the end effector should go: angle and side of the cone, the schedule, and what a step remembers."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, strategies as st
from step_parts import wanted_motion

import ffsms_pin as ffsms
from ffsms_pin.checks import FloatArray
from ffsms_pin.kernel import kernel
from ffsms_pin.opt.step.state import REFERENCES, StepState


@given(st.integers(0, 2**32 - 1), st.floats(-1.0, 1.0))
def test_the_direction_has_the_asked_angle_and_side(seed: int, cosine: float) -> None:
    rng, sms = np.random.default_rng(seed), ffsms.load("planar_3r")
    way, hint = rng.normal(size=3), rng.normal(size=3)
    towards = way / np.linalg.norm(way)
    step = StepState(sms, sms.configuration([0.4, 0.7, -0.5]), np.zeros(3), 0.01, 5.0)
    wanted = wanted_motion(step, step.pose.translation + way, cosine, hint)
    across = hint - (hint @ towards) * towards
    np.testing.assert_allclose(wanted.side, across / np.linalg.norm(across), atol=1e-12)
    assert np.linalg.norm(wanted.direction) == pytest.approx(1.0)
    assert wanted.direction @ towards == pytest.approx(cosine, abs=1e-12)
    assert wanted.side @ hint >= 0.0


def test_a_side_exists_where_the_hint_gives_none(planar: ffsms.SpaceManipulator) -> None:
    towards = np.array([0.0, 0.0, 1.0])
    step = StepState(planar, planar.configuration([0.4, 0.7, -0.5]), np.zeros(3), 0.01, 5.0)
    for hint in (np.zeros(3), 5.0 * towards):
        side = wanted_motion(step, step.pose.translation + towards, 0.6, hint).side
        assert np.linalg.norm(side) == pytest.approx(1.0)
        assert abs(side @ towards) < 1e-12


def test_the_schedule_brings_the_path_to_an_end_at_the_deadline() -> None:
    """Integrated, it leaves what (time left)^2.5 leaves."""
    dt, left, speed = 0.01, 1.0, kernel.ARRIVAL_POWER / 12.0
    for k in range(1200):
        then = kernel.reference_speed(left, speed, 12.0 - k * dt, dt)
        left, speed = left - 0.5 * dt * (speed + then), then
        if k == 1079:
            assert left == pytest.approx(0.1**2.5, rel=0.05)
    assert 0.0 <= left < 1e-5
    assert 0.0 <= speed < 1e-3


def test_the_side_is_given_and_comes_back(planar: ffsms.SpaceManipulator) -> None:
    q, target = planar.configuration([0.4, 0.7, -0.5]), np.array([0.45, 0.75, 0.0])
    step = StepState(planar, q, np.array([0.1, -0.2, 0.1]), 0.01, 5.0)
    towards = target - step.pose.translation
    towards /= np.linalg.norm(towards)
    moving = wanted_motion(step, target, 0.6, np.zeros(3))
    for side in (moving.side, -moving.side):
        wanted = wanted_motion(step, target, 0.6, side)
        np.testing.assert_allclose(wanted.side, side, atol=1e-12)
        np.testing.assert_allclose(wanted.towards, towards, atol=1e-12)
        assert wanted.direction @ towards == pytest.approx(0.6)
        assert wanted.direction @ side > 0.0
    # By default it is the side on which the end effector moves.
    assert moving.side @ (step.J_star[:3] @ step.rates) > 0.0
    arrived = wanted_motion(step, step.pose.translation.copy(), 0.6, moving.side)
    assert arrived.speed == 0.0
    np.testing.assert_array_equal(arrived.direction, np.zeros(3))
    np.testing.assert_array_equal(arrived.side, moving.side)


def test_no_more_speed_is_asked_than_the_joints_can_add(planar: ffsms.SpaceManipulator) -> None:
    q, target = planar.configuration([0.4, 0.7, -0.5]), np.array([0.45, 0.75, 0.0])
    step = StepState(planar, q, np.zeros(3), 0.01, 0.5)
    wanted = wanted_motion(step, target, 1.0, np.zeros(3))
    most = 0.01 * np.abs(wanted.direction @ step.J_star[:3]) @ planar.limits.acceleration
    assert wanted.speed == pytest.approx(most)


def test_the_spin_turns_towards_the_attitude() -> None:
    sms = ffsms.load("satellite_xarm7")
    q = sms.configuration([0.2, -0.5, 0.3, 1.2, 0.2, 0.9, 0.1])
    step = StepState(sms, q, np.zeros(7), 0.01, 5.0)
    turn = np.array([0.1, -0.2, 0.3])

    def wanted_spin(rotation: FloatArray) -> FloatArray:
        spin = wanted_motion(step, step.tip, 1.0, np.zeros(3), rotation).angular_velocity
        assert spin is not None
        return spin

    spin = wanted_spin(pin.exp3(turn) @ step.pose.rotation)
    np.testing.assert_allclose(spin / np.linalg.norm(spin), turn / np.linalg.norm(turn), atol=1e-9)
    np.testing.assert_array_equal(wanted_spin(step.pose.rotation.copy()), np.zeros(3))


def test_prices_of_the_references() -> None:
    """From the state's own matrices, up to scale."""
    sms = ffsms.load("satellite_xarm7")
    q = sms.configuration([0.2, -0.5, 0.3, 1.2, 0.2, 0.9, 0.1])
    step, state = StepState(sms, q, np.zeros(7), 0.01, 5.0), sms.at(q)
    prices = {"least-disturbance": state.C_bm[3:].T @ state.C_bm[3:], "minimum-effort": state.H_q}
    for name, price in prices.items():
        found = REFERENCES[name]
        assert found is not None
        np.testing.assert_allclose(found(step), 7.0 * price / np.trace(price), atol=1e-10)
    assert [name for name, found in REFERENCES.items() if found is None] == ["step", "resolved-rate"]
