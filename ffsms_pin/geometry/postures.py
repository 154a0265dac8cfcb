"""The random search for postures without self-collision."""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray, at_least_zero
from ffsms_pin.errors import InvalidValue
from ffsms_pin.geometry.bodies import clearance_stack
from ffsms_pin.geometry.distances import Poses
from ffsms_pin.geometry.mechanism import ShapedMechanism


def clear_postures(sms: ShapedMechanism, count: int, seed: int, clearance: float, share: float) -> FloatArray:
    """Return k >= `count` random postures (k, n) with a clearance.

    All pairs of `clearance_stack` are at least `clearance` [m] apart. Blocks of 256 postures are drawn from
    the middle `share` of the joint ranges. The range of a revolute joint is limited to [-pi, pi].

    Raises
    ------
    InvalidValue
        Fewer than one posture per 64 blocks has the clearance, or the range of a joint is unbounded or empty.
    """
    block, blocks = 256, 64
    at_least_zero("clearance", clearance, "m")
    turn = np.where(sms.layout.turns, np.pi, np.inf)
    low, high = np.maximum(sms.limits.lower, -turn), np.minimum(sms.limits.upper, turn)
    wrong = ~(np.isfinite(low) & np.isfinite(high) & (low < high))
    if wrong.any():
        i = int(np.argmax(wrong))
        revolute = "must allow a range of positions within [-pi, pi] rad"
        message = revolute if sms.layout.turns[i] else "must be finite, the lower limit below the upper limit"
        given = float(sms.limits.lower[i]), float(sms.limits.upper[i])
        raise InvalidValue(f"the position limits of joint '{sms.joint_names[i]}'", given, message)
    middle, half = 0.5 * (low + high), 0.5 * share * (high - low)
    rng, stack = np.random.default_rng(seed), clearance_stack(sms, "auto", clearance)
    clear: list[FloatArray] = []
    tried = 0
    while len(clear) < count:
        if tried == blocks * (len(clear) + 1):
            message = f"is too large: only {len(clear)} of {tried * block} postures have it; reduce it, or"
            message += " widen the joint limits"
            raise InvalidValue("clearance", clearance, message)
        drawn = middle + half * rng.uniform(-1.0, 1.0, (block, sms.n))
        if stack is not None:
            drawn = drawn[stack.values(Poses.of(drawn.T), clearance).min(axis=0) >= clearance]
        clear, tried = [*clear, *drawn], tried + 1
    return np.array(clear)
