"""The bounds on joint rates keep every joint limit, between nodes too, and are never empty."""

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
    """Positions at a step's start, end and, where a joint turns round inside it, there: shape (3, n)."""
    acceleration = (after - rates) / dt
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = np.where(rates * after < 0.0, -rates / acceleration, 0.0)
    return np.array([q, q + 0.5 * dt * (rates + after), q + turn * rates + 0.5 * turn * turn * acceleration])


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.002, 0.01, 0.05, 0.2]), st.sampled_from([0.0, 0.5, 1.0]))
def test_limits_hold_everywhere_under_any_choice(seed: int, dt: float, extremes: float) -> None:
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


def test_without_room_to_brake_the_position_limit_breaks() -> None:
    """The with/without pair: rate and acceleration limits alone run a joint through its position limit."""
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
    """The formulas of the docstring for one joint, in plain numbers."""
    a, v = float(LIMITS.acceleration[joint]), float(LIMITS.velocity[joint])

    def towards(distance: float, rate: float) -> float:
        room = min(max(distance, 0.0), 1e6)
        # The positive root of dt (rate + w) / 2 + w^2 / (2 a) = room.
        root = -0.5 * dt * a + math.sqrt(max((0.5 * dt * a) ** 2 - 2.0 * a * (0.5 * dt * rate - room), 0.0))
        if root >= 0.0:
            return root
        return min(rate - max(rate, 0.0) ** 2 * dt / (2.0 * max(room, 1e-300)), 0.0)

    upper = min(v, towards(float(LIMITS.upper[joint]) - q, rate), rate + dt * a)
    lower = max(-v, -towards(q - float(LIMITS.lower[joint]), -rate), rate - dt * a)
    lower, upper = min(lower, rate + dt * a), max(upper, rate - dt * a)
    return lower, max(lower, upper)


@settings(max_examples=300, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.002, 0.01, 0.2]), st.sampled_from([0.001, 0.1, 1.5]))
def test_bounds_are_those_of_the_plain_formulas(seed: int, dt: float, excess: float) -> None:
    """Also beyond the limits, and at rates that leave no room to brake."""
    rng = np.random.default_rng(seed)
    lower, upper = np.maximum(LIMITS.lower, -5.0), np.minimum(LIMITS.upper, 5.0)
    for _ in range(5):
        q = rng.uniform(lower - 0.1 * excess, upper + 0.1 * excess)
        rates = (1.0 + excess) * rng.uniform(-1.0, 1.0, 3) * LIMITS.velocity
        found = np.array(rate_bounds(q, rates, LIMITS, dt))
        expected = [joint_bounds(*pair, joint, dt) for joint, pair in enumerate(zip(q, rates, strict=True))]
        np.testing.assert_allclose(found.T, expected, rtol=0.0, atol=1e-12)
        # The acceleration limit is kept whatever else is broken.
        change = dt * LIMITS.acceleration
        assert ((found >= rates - change) & (found <= rates + change)).all()


def test_without_any_limit_the_bounds_are_finite_and_wide() -> None:
    infinite = np.full(3, np.inf)
    free = RobotLimits(-infinite, infinite, infinite, infinite, infinite)
    lower, upper = rate_bounds(np.zeros(3), np.array([0.1, -3.0, 0.0]), free, 0.01)
    assert np.isfinite(lower).all()
    assert np.isfinite(upper).all()
    assert (lower < -1e3).all()
    assert (upper > 1e3).all()
