"""Bounds on joint rates: never empty, and sufficient for all joint limits at and between nodes."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings, strategies as st

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.step.state import rate_bounds
from ffsms_pin.system import RobotLimits

LIMITS = RobotLimits(
    lower=np.array([-1.0, -0.2, -np.inf]),
    upper=np.array([0.5, 0.3, np.inf]),
    velocity=np.array([0.4, 2.0, 1.0]),
    acceleration=np.array([0.5, 0.7, 3.0]),
    torque=np.ones(3),
)


def extreme_positions(q: FloatArray, rates: FloatArray, after: FloatArray, dt: float) -> FloatArray:
    """Return positions (3, n) at a step's start, at its end and at the reversals of joints within it."""
    acceleration = (after - rates) / dt
    with np.errstate(divide="ignore", invalid="ignore"):
        reversal = np.where(rates * after < 0.0, -rates / acceleration, 0.0)
    return np.array(
        [q, q + 0.5 * dt * (rates + after), q + reversal * rates + 0.5 * reversal * reversal * acceleration]
    )


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.002, 0.01, 0.05, 0.2]), st.sampled_from([0.0, 0.5, 1.0]))
def test_any_choice_within_the_bounds_keeps_all_limits(seed: int, dt: float, extremes: float) -> None:
    rng = np.random.default_rng(seed)
    q, rates = np.array([0.0, 0.1, 3.0]), np.zeros(3)
    bias = rng.choice([0.0, 1.0], size=3)
    for _ in range(300):
        lower, upper = rate_bounds(q, rates, LIMITS, dt)
        assert (lower <= upper).all()
        share = rng.uniform(size=3)
        if rng.uniform() < extremes:  # push against one side, or jump between the two
            share = bias if rng.uniform() < 0.9 else 1.0 - bias
        after = lower + share * (upper - lower)
        assert (np.abs(after) <= LIMITS.velocity + 1e-12).all()
        assert (np.abs(after - rates) <= dt * LIMITS.acceleration + 1e-12).all()
        for place in extreme_positions(q, rates, after, dt):
            assert (place <= LIMITS.upper + 1e-9).all()
            assert (place >= LIMITS.lower - 1e-9).all()
        q, rates = q + 0.5 * dt * (rates + after), after


def test_a_joint_without_position_bounds_passes_its_limit() -> None:
    """Rate and acceleration limits alone do not stop a joint at its position limit."""
    dt = 0.01

    def greatest_position(limits: RobotLimits) -> float:
        q, rates, worst = np.array([0.0, 0.1, 3.0]), np.zeros(3), 0.0
        for _ in range(400):
            _, upper = rate_bounds(q, rates, limits, dt)
            q, rates = q + 0.5 * dt * (rates + upper), upper
            worst = max(worst, float(q[0]))
        return worst

    free = RobotLimits(
        np.full(3, -np.inf), np.full(3, np.inf), LIMITS.velocity, LIMITS.acceleration, LIMITS.torque
    )
    assert greatest_position(LIMITS) <= LIMITS.upper[0] + 1e-9
    assert greatest_position(free) > LIMITS.upper[0] + 0.5


def test_a_joint_at_rest_at_its_limit_may_leave_and_not_pass() -> None:
    q = np.array([LIMITS.upper[0], 0.0, 0.0])
    lower, upper = rate_bounds(q, np.zeros(3), LIMITS, 0.01)
    assert upper[0] <= 1e-12
    assert lower[0] == -0.01 * LIMITS.acceleration[0]


def joint_bounds(q: float, rate: float, joint: int, dt: float) -> tuple[float, float]:
    """Return the bounds of one joint by scalar formulas."""
    a, v = float(LIMITS.acceleration[joint]), float(LIMITS.velocity[joint])

    def towards(distance: float, rate: float) -> float:
        distance_left = min(max(distance, 0.0), 1e6)
        # The positive root of dt (rate + w) / 2 + w^2 / (2 a) = distance_left.
        root = -0.5 * dt * a + math.sqrt(
            max((0.5 * dt * a) ** 2 - 2.0 * a * (0.5 * dt * rate - distance_left), 0.0)
        )
        if root >= 0.0:
            return root
        return min(rate - max(rate, 0.0) ** 2 * dt / (2.0 * max(distance_left, 1e-300)), 0.0)

    upper = min(v, towards(float(LIMITS.upper[joint]) - q, rate), rate + dt * a)
    lower = max(-v, -towards(q - float(LIMITS.lower[joint]), -rate), rate - dt * a)
    lower, upper = min(lower, rate + dt * a), max(upper, rate - dt * a)
    return lower, max(lower, upper)


@settings(max_examples=300, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.002, 0.01, 0.2]), st.sampled_from([0.001, 0.1, 1.5]))
def test_bounds_agree_with_the_scalar_formulas(seed: int, dt: float, excess: float) -> None:
    """Some positions are beyond the limits, and some rates are too fast to brake in time."""
    rng = np.random.default_rng(seed)
    lower, upper = np.maximum(LIMITS.lower, -5.0), np.minimum(LIMITS.upper, 5.0)
    for _ in range(5):
        q = rng.uniform(lower - 0.1 * excess, upper + 0.1 * excess)
        rates = (1.0 + excess) * rng.uniform(-1.0, 1.0, 3) * LIMITS.velocity
        bounds = np.array(rate_bounds(q, rates, LIMITS, dt))
        expected = [joint_bounds(*pair, joint, dt) for joint, pair in enumerate(zip(q, rates, strict=True))]
        np.testing.assert_allclose(bounds.T, expected, rtol=0.0, atol=1e-12)
        # The acceleration limit is kept even if other limits are violated.
        change = dt * LIMITS.acceleration
        assert ((bounds >= rates - change) & (bounds <= rates + change)).all()


def test_without_any_limit_the_bounds_are_finite_and_wide() -> None:
    infinite = np.full(3, np.inf)
    free = RobotLimits(-infinite, infinite, infinite, infinite, infinite)
    lower, upper = rate_bounds(np.zeros(3), np.array([0.1, -3.0, 0.0]), free, 0.01)
    assert np.isfinite(lower).all()
    assert np.isfinite(upper).all()
    assert (lower < -1e3).all()
    assert (upper > 1e3).all()
