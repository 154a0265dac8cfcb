"""Rows of a step that keep bodies clear of each other and of obstacles."""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.limits.clearance.distances import Poses
from ffsms_pin.opt.limits.clearance.stack import ClearanceStack
from ffsms_pin.opt.limits.limit import UNBOUNDED, Rows
from ffsms_pin.opt.step.state import StepState
from ffsms_pin.system.batch.stacks import apply, cross

__all__ = ["CLOSING_RATE", "MARGIN", "clearance_rows"]

# [1/s] A clearance may shrink at most this fast relative to what is left of it: slow enough for the arm to
# brake (the paper's arm stops an end effector from 0.2 m/s within a second), fast enough to pass near.
CLOSING_RATE = 2.0
# [m] Kept beyond the asked clearance, so that it also holds between nodes and in spite of curvature.
MARGIN = 2e-3
_STEP = 1e-3  # [s] over which the velocity of an obstacle that moves is a difference


def clearance_rows(stack: ClearanceStack, kept: float, step: StepState) -> Rows:
    """Rows d' >= -CLOSING_RATE (d - kept - MARGIN) of distances d, which give way as fast as the slack.

    Parameters
    ----------
    stack : ClearanceStack
    kept : float
        What is to be kept [m].
    step : StepState
    """
    limits, count = step.sms.limits, len(stack.names)
    poses, moved = stack.at(step.q, step.time), None
    near: FloatArray | float = np.inf
    if stack.reaches is not None:
        fastest = np.minimum(np.abs(step.rates) + limits.acceleration * step.dt, limits.velocity)
        closing = stack.reaches @ fastest
        if stack.passes.any():
            moved = _Passing(stack, step, poses)
            closing += moved.fastest(fastest)
        # Beyond this distance rates up to the fastest are too slow for a row to bind.
        near = kept + MARGIN + closing / CLOSING_RATE
    where = stack.every(poses)
    found = stack.nearest(poses, where, near)
    slopes, placed = stack.slopes(poses, where, found)
    G = np.ascontiguousarray(slopes.T)
    least = CLOSING_RATE * (kept + MARGIN - found.distance)
    if moved is not None:
        by = moved.slopes(placed)
        G += by[:-1].T
        least -= by[-1]
    return Rows(G, least, np.full(count, UNBOUNDED), give=1.0)


class _Passing:
    """How the second bodies of pairs move as the base sees them, by the joints and what is given."""

    def __init__(self, stack: ClearanceStack, step: StepState, poses: Poses) -> None:
        index = stack.bodies[:, 1] - stack.sms.n
        self._passes, self._far = stack.passes, stack.sizes[:, 1]
        # Twist of the base (6, 1, n + 1), a column for each joint and one that is given by the momentum.
        self._base = np.column_stack([step.reaction, step.drift])[:, None]
        self._turns, self._origins = poses.turns[:, :, index, 0], poses.origins[:, index, 0]
        self._way, self._turning = np.zeros_like(self._origins), np.zeros_like(self._turns)
        if any(one.moves for one in stack.obstacles):
            before, after = (stack.at(step.q, step.time + h) for h in (-_STEP, _STEP))
            self._way = (after.origins - before.origins)[:, index, 0] / (2.0 * _STEP)
            self._turning = (after.turns - before.turns)[:, :, index, 0] / (2.0 * _STEP)

    def fastest(self, rates: FloatArray) -> FloatArray:
        """Speeds (m,) that no point of the bodies exceeds at joint rates up to `rates` (n,) [m/s]."""
        base, far = self._base, self._far
        linear = np.linalg.norm(base[:3] + cross(base[3:], self._origins[..., None]), axis=0)
        speeds = linear + far[:, None] * np.linalg.norm(base[3:], axis=0)
        own = np.linalg.norm(self._way, axis=0) + far * np.linalg.norm(self._turning, axis=(0, 1))
        return np.asarray(self._passes * (speeds @ np.append(rates, 1.0) + own))

    def slopes(self, placed: FloatArray) -> FloatArray:
        """How fast distances grow by that (n + 1, m): by a unit rate of each joint, and given."""
        here, there, normal = placed
        moves = -(self._base[:3] + cross(self._base[3:], here[..., None]))
        local = apply(self._turns.transpose(1, 0, 2), there - self._origins)
        moves[..., -1] += self._way + apply(self._turning, local)
        return np.asarray(self._passes * np.einsum("xvj,xv->jv", moves, normal))
