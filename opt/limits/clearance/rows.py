"""Rows of a step that keep bodies clear of each other and of obstacles."""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.limits.clearance.stack import ClearanceStack
from ffsms_pin.opt.limits.limit import UNBOUNDED, Rows
from ffsms_pin.opt.limits.step_state import StepState
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
    limits, count, index = step.sms.limits, len(stack.names), stack.bodies[:, 1]
    poses = stack.at(step.q, step.time)
    # Of the root by the joints, and given by the momentum; of obstacles by themselves, as the base sees them.
    base = np.column_stack([step.reaction, step.drift])[:, None]
    own_ways, own_turns = _own_rates(stack, step)
    near: FloatArray = np.full(count, np.inf)
    if stack.reaches is not None:
        # Beyond this distance rates up to the fastest are too slow for a row to bind.
        fastest = np.minimum(np.abs(step.rates) + limits.acceleration * step.dt, limits.velocity)
        passing, far = cross(base[3:], poses.origins[:, index]), stack.sizes[:, 1]
        speeds = np.linalg.norm(base[:3] + passing, axis=0) + far[:, None] * np.linalg.norm(base[3:], axis=0)
        given = np.linalg.norm(own_ways, axis=0) + far * np.linalg.norm(own_turns, axis=(0, 1))
        closing = stack.reaches @ fastest + stack.passes * (speeds @ np.append(fastest, 1.0) + given)
        near = kept + MARGIN + closing / CLOSING_RATE
    every, at = np.arange(count), np.zeros(count, dtype=np.intp)
    found = stack.nearest(poses, (every, at), near)
    G = np.where(found.distance < near, stack.gradients(poses, (every, at), found), 0.0).T
    least = CLOSING_RATE * (kept + MARGIN - found.distance)
    if stack.passes.any():
        # The obstacle's nearest point is left behind by the base, and moves by itself.
        moves = -(base[:3] + cross(base[3:], found.here[..., None]))
        local = apply(
            poses.rotations[:, :, index, 0].transpose(1, 0, 2), found.there - poses.origins[:, index, 0]
        )
        moves[..., -1] += own_ways + apply(own_turns, local)
        by = (found.distance < near) * stack.passes * np.einsum("xvj,xv->jv", moves, found.normal)
        G += by[:-1].T
        least -= by[-1]
    return Rows(G, least, np.full(count, UNBOUNDED), give=1.0)


def _own_rates(stack: ClearanceStack, step: StepState) -> tuple[FloatArray, FloatArray]:
    """How fast the second bodies of pairs move (3, m) and turn (3, 3, m) by themselves, base axes."""
    index = stack.bodies[:, 1]
    if not any(one.moves for one in stack.obstacles):
        return np.zeros((3, len(index))), np.zeros((3, 3, len(index)))
    ends = [stack.at(step.q, step.time + h) for h in (-_STEP, _STEP)]
    turns, ways = ((b - a) / (2.0 * _STEP) for a, b in zip(ends[0][:2], ends[1][:2], strict=True))
    return ways[:, index, 0], turns[:, :, index, 0]
