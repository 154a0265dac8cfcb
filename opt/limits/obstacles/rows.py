"""Rows of a step that keep the robot clear of obstacles."""

from __future__ import annotations

import numpy as np

from ffsms_pin.checks import FloatArray
from ffsms_pin.opt.batch.residual import Indices
from ffsms_pin.opt.limits.clearance_rows import CLOSING_RATE, MARGIN
from ffsms_pin.opt.limits.limit import UNBOUNDED, Rows
from ffsms_pin.opt.limits.obstacles.stack import ObstacleStack
from ffsms_pin.opt.limits.part_pairs import Nearest, Poses
from ffsms_pin.opt.limits.step_state import StepState
from ffsms_pin.system.batch.stacks import cross, dot

__all__ = ["obstacle_rows"]

_STEP = 1e-3  # [s] over which the velocity of an obstacle that moves is a difference


def obstacle_rows(stack: ObstacleStack, kept: float, step: StepState) -> Rows:
    """Rows d' >= -CLOSING_RATE (d - kept - MARGIN) of every distance d that may become that small.

    The base reacts to the joints: d' = G u, plus what the total momentum and the obstacle's motion add.
    """
    n = step.sms.n
    poses = stack.seen_at(step.q, step.time)
    limits = step.sms.limits
    fastest = np.minimum(np.abs(step.rates) + limits.acceleration * step.dt, limits.velocity)
    moving = np.array([one.moves for one in stack.obstacles], dtype=bool)[stack.others]
    before, after = (
        (stack.seen_at(step.q, step.time + h) for h in (-_STEP, _STEP)) if moving.any() else (poses, poses)
    )
    near = kept + MARGIN + _fastest_closing(stack, step, poses, before, after, fastest) / CLOSING_RATE
    value = stack.bounds(poses, near)
    columns = np.flatnonzero(value < near)
    G, given = np.zeros((len(value), n)), np.zeros(len(value))
    if columns.size:
        where = (columns, np.zeros_like(columns))
        found = stack.nearest(poses, where)
        value[columns] = found.distance
        G[columns] = stack.pairs.by_joints(poses, where, found).T
        apart = np.where(stack.on_base[columns], 0.0, 1.0)
        # Of the base's motion at the body's nearest point, base axes (V, n + 1): by the joints, and given.
        base = np.column_stack([step.reaction, step.drift])
        velocity = base[:3, None] + np.cross(base[3:].T[:, None], found.here.T[None], axis=2).transpose(
            2, 1, 0
        )
        closing = apart[:, None] * np.einsum("xvj,xv->vj", velocity, found.normal)
        G[columns] -= closing[:, :n]
        given[columns] = _own_speed(stack, columns, found, poses, before, after) - closing[:, n]
    least = CLOSING_RATE * (kept + MARGIN - value) - given
    return Rows(G, least, np.full(least.size, UNBOUNDED), give=1.0)


def _own_speed(
    stack: ObstacleStack, columns: Indices, found: Nearest, poses: Poses, before: Poses, after: Poses
) -> FloatArray:
    """How fast distances (V,) grow by the obstacles' own motion [m/s]."""
    if before is poses:
        return np.zeros(len(columns))
    index = stack.arm.n + stack.others[columns]
    R, o = poses.rotations[:, :, index, 0], poses.origins[:, index, 0]
    local = np.einsum("yxv,yv->xv", R, found.there - o)
    ends = [
        one.origins[:, index, 0] + np.einsum("xyv,yv->xv", one.rotations[:, :, index, 0], local)
        for one in (before, after)
    ]
    return dot((ends[1] - ends[0]) / (2.0 * _STEP), found.normal)


def _fastest_closing(
    stack: ObstacleStack, step: StepState, poses: Poses, before: Poses, after: Poses, fastest: FloatArray
) -> FloatArray:
    """How fast distances (m,) can shrink at most within the step [m/s]: balls around the bodies."""
    body = stack.bodies
    carries = np.vstack([stack.arm.carries.T, np.zeros(stack.arm.n)])[body]
    centre = poses.origins[:, body, 0] + np.einsum(
        "xym,my->xm", poses.rotations[:, :, body, 0], stack.centres
    )
    axes, velocities = poses.axes[..., 0], poses.velocities[..., 0]
    apart = np.where(stack.on_base, 0.0, 1.0)
    turning = axes[:, None] * carries + apart[:, None] * step.reaction[3:, None]
    sliding = velocities[:, None] * carries + apart[:, None] * step.reaction[:3, None]
    linear = sliding + cross(turning, centre[..., None])
    speeds = np.sqrt(dot(linear, linear)) + stack.radii[:, None] * np.sqrt(dot(turning, turning))
    drift = apart * (
        np.linalg.norm(step.drift[:3])
        + np.linalg.norm(step.drift[3:]) * (np.linalg.norm(centre, axis=0) + stack.radii)
    )
    most: FloatArray = speeds @ fastest + drift
    if before is not poses:
        index = stack.arm.n + stack.others
        way = after.origins[:, index, 0] - before.origins[:, index, 0]
        turned = after.rotations[:, :, index, 0] - before.rotations[:, :, index, 0]
        most = most + (np.linalg.norm(way, axis=0) + stack.far * np.linalg.norm(turned, axis=(0, 1))) / (
            2.0 * _STEP
        )
    return most
