"""Postures that a motion may begin in: clear of the robot's own bodies."""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray, number
from ffsms_pin.errors import InvalidValue
from ffsms_pin.geometry.bodies import clearance_stack
from ffsms_pin.geometry.distances import Poses
from ffsms_pin.geometry.mechanism import ShapedMechanism


def clear_postures(sms: ShapedMechanism, count: int, seed: int, clearance: float, share: float) -> FloatArray:
    """Return `count` or more joint positions (k, n) from a share of the ranges about their middles.

    Drawn by 256; what 64 times as many do not show is as good as not there.
    """
    block, blocks = 256, 64
    number("clearance", clearance)
    turn = np.where(sms.layout.turns, np.pi, np.inf)
    low, high = np.maximum(sms.limits.lower, -turn), np.minimum(sms.limits.upper, turn)
    wrong = ~(np.isfinite(low) & np.isfinite(high) & (low < high))
    if wrong.any():
        name = sms.joint_names[int(np.argmax(wrong))]
        raise InvalidValue("limits", name, "must be finite where a joint slides, and within half a turn")
    middle, half = 0.5 * (low + high), 0.5 * share * (high - low)
    rng, stack = np.random.default_rng(seed), clearance_stack(sms, "auto", clearance)
    clear: list[FloatArray] = []
    tried = 0
    while len(clear) < count:
        if tried == blocks * (len(clear) + 1):
            message = f"is kept by {len(clear)} of {tried * block} postures; ask for less, or widen limits"
            raise InvalidValue("clearance", clearance, message)
        drawn = middle + half * rng.uniform(-1.0, 1.0, (block, sms.n))
        if stack is not None:
            drawn = drawn[stack.values(Poses.of(drawn.T), clearance).min(axis=0) >= clearance]
        clear, tried = [*clear, *drawn], tried + 1
    return np.array(clear)
