"""The Gymnasium environment passes Gymnasium's own checks, keeps the limits, and can be solved."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import ffsms_pin as ffsms
from ffsms_pin.interchange.gymnasium_env import ReachEnv


@pytest.mark.parametrize("name", ["planar_3r", "space_arm_7"])
def test_it_is_made_by_its_name_and_passes_the_checker(name: str) -> None:
    """All of the checker, pictures included, which warns of nothing."""
    made: Any = gym.make("ffsms-pin/Reach-v0", sms=name, duration=1.0, render_mode="rgb_array")
    check_env(made.unwrapped)
    assert made.observation_space.is_bounded()


@pytest.mark.parametrize("name", ["planar_3r", "space_arm_7"])
def test_bounds_hold_without_being_met(name: str) -> None:
    """They are cut off at, so they must be wide enough for what happens at full rates."""
    env: Any = ReachEnv(name)
    rng, high = np.random.default_rng(2), env.observation_space.high
    env.reset(seed=0)
    largest = np.zeros_like(high)
    for k in range(120):
        if k % 20 == 0:
            action = rng.choice([-1.0, 1.0], env.sms.n).astype(np.float32)
        largest = np.maximum(largest, np.abs(env.step(action)[0]))
    assert (largest[2 * env.sms.n :] < high[2 * env.sms.n :]).all()
    assert (largest[-6:] > 0.01 * high[-6:])[high[-6:] > 1e-5].all()  # and no wider than it takes


def test_a_picture_shows_the_state() -> None:
    env: Any = ReachEnv("planar_3r", render_mode="rgb_array")
    env.reset(seed=1)
    first = env.render()
    np.testing.assert_array_equal(env.render(), first)
    assert first.shape == (480, 480, 3)
    for _ in range(20):
        env.step(np.ones(3, dtype=np.float32))
    assert (env.render() != first).any(axis=2).sum() > 200  # pixels
    assert ReachEnv("planar_3r").render() is None


def test_the_same_seed_is_the_same_episode() -> None:
    env = ReachEnv(ffsms.load("planar_3r"))
    runs = []
    for _ in range(2):
        env.reset(seed=4)
        rng = np.random.default_rng(1)
        runs.append(np.array([env.step(rng.uniform(-1, 1, 3).astype(np.float32))[0] for _ in range(5)]))
    np.testing.assert_array_equal(runs[0], runs[1])


def test_full_actions_stop_at_the_limits_and_momentum_stays_zero() -> None:
    sms = ffsms.load("planar_3r")
    env = ReachEnv(sms, duration=60.0)
    env.reset(seed=0, options={"target": [0.0, -2.0, 0.0]})
    for _ in range(300):
        env.step(np.ones(3, dtype=np.float32))
    joints = sms.joint_positions(env.q)
    assert (sms.limits.upper - joints > -1e-3).all()
    assert (sms.limits.upper - joints < 2e-2).all()
    assert np.abs(sms.at(env.q, env.v).momentum).max() < 1e-10


def test_a_simple_policy_arrives() -> None:
    """Rates through the generalised Jacobian's transpose bring the planar arm to its target."""
    sms = ffsms.load("planar_3r")
    env = ReachEnv(sms, start=[0.5, 0.5, 0.5], duration=40.0)
    env.reset(seed=0, options={"target": [0.7, 0.45, 0.0]})
    total, arrived = 0.0, False
    while not arrived:
        state = sms.at(env.q)
        way = env.target - state.end_effector_pose.translation
        rates = 2.0 * np.linalg.pinv(state.J_star[:3], rcond=0.05) @ way
        action = np.clip(rates / sms.limits.velocity, -1.0, 1.0).astype(np.float32)
        _, reward, arrived, over, _ = env.step(action)
        total += reward
        assert not over
    assert total > 1.0
