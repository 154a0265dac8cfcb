"""A target that may move: where it is, and how far ahead of it to aim."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.targets import Goal, goal

__all__ = ["Target", "goal_at", "lead"]

Target: TypeAlias = Any  # array_like (3,), pinocchio.SE3, or a function of time [s] that gives one


def goal_at(target: Target, t: float) -> Goal:
    """Where a target is at t [s]."""
    return goal(target(t) if callable(target) else target)


def lead(target: Target, t: float, left: float, dt: float) -> FloatArray:
    """How far ahead of a moving target to aim (3,) [m].

    The step's speed is 2.5 times the way over the time left, each a little later (`reference_speed`). Aimed
    at a point that is ahead by that time's share of the target's velocity, what is left of the way beyond the
    lead shrinks as for a target at rest, and the end effector arrives with that velocity.

    Parameters
    ----------
    target : Target
    t, left, dt : float
        Now, until the deadline, and the planning step [s].
    """
    if not callable(target):
        return np.zeros(3)
    before = max(t - dt, 0.0)
    velocity = (goal_at(target, t + dt).position - goal_at(target, before).position) / (dt + min(dt, t))
    return velocity * ((max(left - dt, 0.0) + 3.25 * dt) / 2.5 + 0.5 * dt)
